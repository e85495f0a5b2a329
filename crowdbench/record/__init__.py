"""Recordings: what an episode leaves in Rerun's format, how it is drawn, read back and viewed."""
