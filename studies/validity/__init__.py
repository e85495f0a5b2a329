"""Validity of pedestrian policies: what crowds that they move do, beside what is published about pedestrians."""
