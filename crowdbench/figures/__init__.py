"""Figures of runs for papers, drawn by Matplotlib."""
