"""The version of the simulator."""

SIMULATOR = 1
"""Version of the simulator. Raise it when an episode or a metric of an unchanged scenario moves: see tests/golden."""
