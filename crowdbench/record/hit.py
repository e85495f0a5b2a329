"""Whom the vehicle hits."""

from __future__ import annotations

import numpy as np

from crowdbench.dynamics import Holonomic
from crowdbench.geometry import nearest_in_step, turn
from crowdbench.sim.episode import swept_motion
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import Trace


def pedestrian_hit(trace: Trace, row: int) -> int:
    """Number of the pedestrian nearest to the vehicle in the last step, by the rule of the collision check."""
    last = row, trace.steps[row] - 1
    position, radius, present = trace.position[last], trace.radius[last], trace.present[last]
    motion = swept_motion(position, trace.position[row, trace.steps[row]], trace.velocity[last], trace.rules)
    if isinstance(trace.rules.dynamics, Holonomic):
        return int(nearest_in_step(0, position, motion, radius, present)[1]) - 1
    heading = trace.heading[row, trace.steps[row] - 1 : trace.steps[row] + 1]
    speed, rules = float(np.hypot(*trace.velocity[row, trace.steps[row], 0])), trace.rules
    drive = heading[0], speed, turn(*heading) / rules.dt, rules.dt
    here = np.nan_to_num(position), np.nan_to_num(motion), radius
    each = [present & (np.arange(len(present)) == agent) for agent in range(1, len(present))]
    gaps = [gaps_on_arc(np.array(rules.body), *drive, *here, only, trace.obstacles[row, :0])[0] for only in each]
    return int(np.argmin(gaps))
