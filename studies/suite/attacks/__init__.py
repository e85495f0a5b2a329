"""Planners that try to have a good score without good navigation."""
