"""Numbers of steps for which predictors are measured. They are separate, because the command starts without torch."""

HORIZON = 8
"""The default number of steps."""

MOST_AHEAD = 1000
"""The most steps: more than any episode has at the usual time steps."""
