"""Planners: what decides the vehicle's velocity, and the parts that planners are composed of."""
