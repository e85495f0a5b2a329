"""Leaderboards: what a board asks for, what an entry is, and what a rank means."""
