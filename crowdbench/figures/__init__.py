"""Figures and tables of runs for papers."""
