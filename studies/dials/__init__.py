"""Dials: scenarios with one knob, and the level up to which a planner succeeds in 90 % of the cases."""
