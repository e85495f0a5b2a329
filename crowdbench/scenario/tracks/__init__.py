"""Recorded tracks of real pedestrians and cars: their files and time windows."""
