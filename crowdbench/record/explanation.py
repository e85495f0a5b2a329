"""Texts of an episode: the causes of its failure, its metrics, and the meanings of the marks in its recording."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import norm, turn
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import agent_name
from crowdbench.metrics.contacts import contacts_of
from crowdbench.metrics.fault import SMALL_SHARE, WINDOW
from crowdbench.record import decisions, marks

PREDICTED_LOG = "predicted"
"""The log `[world, mode, time, pedestrian, 2]` of predicted positions, in metres, from the next step on."""

BEFORE = (1.0, 0.5, 0.0)
"""Times in seconds before a contact for which the expected gaps are computed; 0 stands for the last decision."""

SLOW = 0.1
"""Speed in m/s below which a vehicle counts as standing."""


def describe_failure(trace: Trace, row: int) -> list[str]:
    """Return three sentences on a failure: the cause, its prediction, and the motion of both agents.

    There are none for an episode that succeeds. The prediction is that in `PREDICTED_LOG`; without this log,
    pedestrians are extrapolated at constant velocity.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
    """
    steps, dt, outcome = int(trace.steps[row]), trace.rules.dt, Outcome(int(trace.outcome[row]))
    speed = norm(trace.velocity[row, : steps + 1, 0])
    if outcome is Outcome.COLLISION:
        contacts = contacts_of(trace)
        agent, share, saw = (array[row].item() for array in (contacts.agent, contacts.share, contacts.saw))
        first = f"Collision with {agent_name(agent, trace.rules)} at {steps * dt:g} s: {_fault(share)}"
        return [first, _expected(trace, row, agent), _describe_motion(trace, row, agent, saw=saw)]
    if outcome is Outcome.WALL_COLLISION:
        ahead = [f"{trace.wall_gap[row, state - 1]:z.2f} m at {state * dt:g} s" for state in _states_before(steps, dt)]
        first = f"Collision with an obstacle at {steps * dt:g} s: the vehicle is at fault."
        second = f"The gap to the obstacle was {', '.join(ahead)}; the vehicle drove at {speed[-1]:.1f} m/s."
    elif outcome is Outcome.TIMEOUT:
        left = norm(trace.goal[row, steps, 0] - trace.position[row, : steps + 1, 0])
        first = f"Out of time at {steps * dt:g} s: the vehicle was {left[-1]:.1f} m from its goal."
        stood = f"The vehicle stood for {dt * float((speed[1:] < SLOW).sum()):g} s"
        second = f"{stood}, and was nearest to the goal at {int(left.argmin()) * dt:g} s, {left.min():.1f} m from it."
    else:
        return []
    return [first, second, _nearest(trace, row)]


def _fault(share: float) -> str:
    """Return the end of a sentence on the fault, from the vehicle's share of the approach."""
    if math.isnan(share):
        return "the fault is undetermined, because both hardly moved."
    made = f"it made {math.floor(100.0 * share + 1e-9)} % of the approach ({100.0 * SMALL_SHARE:g} % or more counts)."
    return f"the vehicle is {'' if share >= SMALL_SHARE else 'not '}at fault, because {made}"


def _nearest(trace: Trace, row: int) -> str:
    """Return a sentence on the smallest gap to a pedestrian and its time."""
    gap = trace.gap[row, : trace.steps[row]]
    at = (int(gap.argmin()) + 1) * trace.rules.dt
    if not np.isfinite(gap.min()):
        return ""
    return f"The smallest gap to a pedestrian was {_length(gap.min())}, at {at:g} s."


def _length(gap: float) -> str:
    """Return a gap in metres as a text. Discs that overlap have no gap."""
    return f"{max(gap, 0.0):.2f} m"


def _states_before(steps: int, dt: float) -> list[int]:
    """Return the states at the times `BEFORE` the last one, at the latest the state of the last decision."""
    return sorted({max(1, steps - max(round(each / dt), 1)) for each in BEFORE})


def _expected(trace: Trace, row: int, agent: int) -> str:
    """Return a sentence on the time at which decisions first expected the contact with a pedestrian."""
    steps, dt, logged = int(trace.steps[row]), trace.rules.dt, trace.logs.get(PREDICTED_LOG)
    is_of_tracks = trace.rules.sensor.detector is not None
    if logged is not None and (
        is_of_tracks or logged.ndim < 5 or logged.shape[-2:] != (trace.position.shape[2] - 1, 2)
    ):
        logged = None
    gaps = {}
    for state in _states_before(steps, dt):
        if logged is not None:
            position = _prediction(logged[row].reshape(logged.shape[1], -1, *logged.shape[-3:]), state, steps, agent)
        else:
            moved = (steps - state) * dt * trace.velocity[row, state, agent]
            position = (trace.position[row, state, agent] + moved)[None]
        distance = float(np.median(norm(position - trace.position[row, steps, 0])))
        if np.isfinite(distance):
            gaps[(steps - state) * dt] = distance - trace.radius[row, steps, [0, agent]].sum()
    how = "at constant velocity" if logged is None else "by the planner"
    if not gaps:
        return "The pedestrian was not predicted, because the vehicle did not see it."
    ahead = next((ahead for ahead, gap in gaps.items() if gap < 0.0), None)
    if ahead is None:
        last, gap = list(gaps.items())[-1]
        return f"Contact was not predictable: {last:g} s earlier, the gap predicted {how} was {_length(gap)}."
    return f"Contact was predictable {how} {'a second' if ahead == 1.0 else f'{ahead:g} s'} earlier."


def _prediction(
    predicted: Float[np.ndarray, "step mode time pedestrian 2"], state: int, steps: int, agent: int
) -> Float[np.ndarray, "mode 2"]:
    """Return the position of a pedestrian after `steps`, as predicted by the last decision up to a state; or NaN."""
    made = np.flatnonzero(np.isfinite(predicted[: state + 1, :, 0, agent - 1, 0]).any(axis=1))
    ahead = steps - int(made[-1]) - 1 if len(made) else predicted.shape[2]
    return predicted[made[-1], :, ahead, agent - 1] if ahead < predicted.shape[2] else np.full((1, 2), np.nan)


def _describe_motion(trace: Trace, row: int, agent: int, *, saw: bool) -> str:
    """Return sentences on the motion of both agents in the last second, and on their perception of each other."""
    steps, dt = int(trace.steps[row]), trace.rules.dt
    change = trace.velocity[row, [max(1, steps - round(WINDOW / dt)), steps]][:, [0, agent]]
    (vehicle, person), (vehicle_now, person_now) = norm(change).tolist()
    turned = np.degrees(np.abs(turn(*np.arctan2(change[:, 1, 1], change[:, 1, 0]))))
    unseen = np.flatnonzero(~trace.seen[row, : steps + 1, agent - 1])
    if len(unseen) and unseen[-1] == steps:
        perception = "The vehicle did not see the pedestrian at the end"
    else:
        seconds = (steps - unseen[-1] - 1) * dt if len(unseen) else math.inf
        seen = f"for {seconds:g} s" if seconds > 0.0 else "only at the contact"
        perception = f"The vehicle had seen the pedestrian {seen if len(unseen) else 'all the time'}"
    return (
        f"In the last second, {agent_name(agent, trace.rules)} turned by {turned:.0f}° and went from {person:.1f} to "
        f"{person_now:.1f} m/s, the vehicle from {vehicle:.1f} to {vehicle_now:.1f} m/s. {perception}; the "
        f"pedestrian had {'' if saw else 'not '}noticed the vehicle."
    )


def summary_text(trace: Trace, row: int, title: str) -> str:
    """Return the text beside the picture: the outcome of the episode, its case, planner and scenario.

    Args:
        trace: The trace with the episode.
        row: Its row.
        title: Planner and scenario.
    """
    success = [f"Success after {trace.steps[row] * trace.rules.dt:g} s", _nearest(trace, row)]
    first, *others = describe_failure(trace, row) or success
    return "\n\n".join([f"## {first}", *others, f"case {trace.split}/{trace.case[row]} · {title}"])


def legend_text(trace: Trace, row: int) -> str:
    """Return the meanings of the marks that an episode has, as a table."""
    sensor, decided = trace.rules.sensor, decisions.marks_of(trace)
    is_limited = sensor.range is not None or sensor.field_of_view < 360.0 or sensor.lidar is not None
    meanings = {
        "orange | the vehicle, its path and its goal": True,
        "blue | pedestrians; dots: their goals": True,
        "arrow | the path of the next second": True,
        f"line with a gap | the closest approach, within {marks.AHEAD:g} s and {marks.NEAR:g} m": True,
        "star | the contact": trace.outcome[row] in (Outcome.COLLISION, Outcome.WALL_COLLISION),
        "dashed outline | a pedestrian that the vehicle does not see": trace.perceived is not None,
        "orange, brown ring | where the vehicle measures, or remembers, a pedestrian": trace.perceived is not None,
        "dark grey lines | the limits of the sensor": is_limited,
        "fan of arrows | commands; orange: the best": "commands" in decided,
        "grey lines | predicted paths, fainter with time": "predicted" in decided,
        f"brown lines | the best {decisions.BEST} of the paths that were considered": "considered" in decided,
        "thick orange line | the planned path": "planned" in decided,
        "pale lines | attention, wider for more": decisions.ATTENTION_LOG in decided,
    }
    shown = [f"| {meaning} |" for meaning, is_shown in meanings.items() if is_shown]
    return "\n".join(["| mark | meaning |", "|---|---|", *shown])


def metrics_text(values: Mapping[str, str]) -> str:
    """Return the metrics of an episode as a table."""
    return "\n".join(
        ["| metric | value |", "|---|---:|", *(f"| {title} | {value} |" for title, value in values.items())]
    )
