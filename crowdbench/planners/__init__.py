"""Planners, which decide the vehicle's velocity, and their components."""
