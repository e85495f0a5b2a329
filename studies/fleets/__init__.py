"""Planners and networks that drive all vehicles of a world."""
