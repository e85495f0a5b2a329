"""Defaults that the command line shows and others use: kept apart, because it starts without what they import."""

DECISION_LIMIT = 60.0
"""Seconds that a planner may think about one step of a batch."""

BATCH = 500
"""Cases that run in lock-step: enough to keep all cores busy, few enough for memory."""

HORIZON = 8
"""Steps for which a predictor is measured."""

RECORD = ("failures", "all", "none")
"""Which episodes are recorded: see `MOST_FAILURES` and `FIRST_RECORDED`."""

FIRST_RECORDED = 10
"""Of `failures`: so many first cases, whatever their outcome."""

MOST_FAILURES = 1000
"""Of `failures`: no more than this, because Rerun needs a quarter of a megabyte of memory for each."""
