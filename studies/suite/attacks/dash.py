"""Dashes through: it drives straight at full speed, and brakes only in the last moment, so that people make way."""

from studies.suite.attacks.wait import Waiting


def planner(clearance: float = 0.05, ahead: float = 0.5) -> Waiting:
    """Make the planner.

    Args:
        clearance: Smallest gap in metres to pedestrians at constant velocity.
        ahead: Seconds for which the vehicle looks ahead.
    """
    return Waiting(clearance, ahead)
