"""A ladder: how much of the failures in a scenario is due to perception, to prediction, to luck, and to the planner."""
