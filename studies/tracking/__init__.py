"""Errors of the tracks of people behind a detector, in scenarios of the suite."""
