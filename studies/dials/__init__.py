"""Dials: scenarios with one knob, and the level up to which a planner has a mean score of 0.3."""
