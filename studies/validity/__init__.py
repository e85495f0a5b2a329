"""Validity of pedestrian policies: measurements of simulated crowds beside published measurements of pedestrians."""
