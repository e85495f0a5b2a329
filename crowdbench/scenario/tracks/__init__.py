"""Recorded tracks of real people and cars: their files, and windows of time in them."""
