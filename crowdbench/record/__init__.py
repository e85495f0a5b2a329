"""Recordings of episodes in Rerun's format: written, read back and viewed."""
