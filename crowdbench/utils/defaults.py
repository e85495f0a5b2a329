"""Defaults of the command line. They are separate, because it starts without the modules that use them."""

DECISION_LIMIT = 60.0
"""Seconds that a planner may take for one decision, for all worlds of a batch together."""

START_LIMIT = 60.0
"""Seconds that a plug-in may take for its import, for its construction, and for any call that is not a decision. A
longer decision limit applies to the start of a run too."""

BATCH = 500
"""Cases that run in lock-step: enough for all cores, few enough for the memory."""

RECORD = ("failures", "all", "commands", "none")
"""Extents of recordings: the commands of all cases unless it is "none", and with `WITH_EPISODES` episodes for the
viewer."""

WITH_EPISODES = ("failures", "all")
"""Extents that include episodes for the viewer: see `MOST_FAILURES` and `FIRST_RECORDED`."""

FIRST_RECORDED = 10
"""With "failures": the number of first cases that are recorded, independent of their outcome."""

MOST_FAILURES = 100
"""With "failures": the largest number of recorded failures. More would take longer to record than a fast planner takes
to drive, and are not needed."""

RECORDED_CROWD = 100
"""In scenarios with more pedestrians, fewer failures are recorded: inversely proportional to their number."""
