"""Ranks of boards, and their pages."""
