"""The part of a recording that is read back: episodes in full precision, under `/exact`, which no view shows.

`/exact/vehicle`, `/exact/pedestrian_0`, ... have a row per state, with what changes in the episode; a quantity of a
step is in the row of the state that the step leads to. `/exact/episode` has one row with what does not change.

Formats 1 to 3 had all agents in one entity, `/exact/states`. Format 1 had no heading, command, gap to obstacles, person
and sight. When it is read, the heading is computed from the velocities, the command is the vehicle's velocity, and the
rest has the only value that was possible then. Format 2 had no route and obstacles, because there were none. What the
vehicle perceived is there where its sight was limited, groups where the scenario has them.

`write` and `read` use this module; `drawing` makes what the viewer shows.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Shaped
from rerun.chunk import Chunk

from crowdbench.errors import InputError
from crowdbench.geometry import heading_of
from crowdbench.record.chunks import times
from crowdbench.types import Rules, Trace

FORMAT = 4
"""Version of what is under `/exact`."""

READABLE = (1, 2, 3, 4)
"""Versions that `trace` can read."""

OF_STATES = ("position", "velocity", "heading", "goal", "radius", "present", "person", "seen")
OF_STEPS = ("command", "gap", "wall_gap")
OPTIONAL = ("undisturbed", "perceived", "age", "group")

OF_VEHICLE = ("heading", *OF_STEPS)
"""What only the vehicle has."""

OF_PEDESTRIANS = ("person", "seen", *OPTIONAL)
"""What only pedestrians have."""

Episode = dict[str, np.ndarray]
"""Arrays of one episode by name, each with one axis."""


def chunks(trace: Trace, row: int, run: Mapping[str, Any]) -> Iterator[Chunk]:
    """One episode as Rerun chunks.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        run: Facts about the whole run, of types that JSON has.

    Yields:
        The chunks of the agents and of `/exact/episode`.
    """
    steps, dt = int(trace.steps[row]), trace.rules.dt
    arrays = {name: getattr(trace, name)[row, : steps + 1] for name in OF_STATES}
    arrays |= {name: getattr(trace, name)[row, :steps] for name in OF_STEPS}
    for name in OPTIONAL:
        if getattr(trace, name) is not None:
            arrays[name] = getattr(trace, name)[row, : steps + 1]
    # The position always changes, or else agents could have no columns.
    still = {name: array[:1] for name, array in arrays.items() if name != "position" and (array == array[:1]).all()}
    moving = {name: _of_states(array, steps + 1) for name, array in arrays.items() if name not in still}
    timelines = {moment.timeline_name(): moment.as_arrow_array() for moment in times(0, steps + 1, dt)}
    for agent in range(trace.position.shape[2]):
        columns = timelines | {name: _lists(array) for name, array in _of_agent(moving, agent)}
        yield from Chunk.from_record_batch(
            pa.record_batch(columns), index=[*timelines], entity_path=f"/exact/{_agent_name(agent)}"
        )
    still["preferred_speed"] = trace.preferred_speed[row : row + 1]
    still["case_outcome_steps"] = np.array([[trace.case[row], trace.outcome[row], trace.steps[row]]])
    if trace.block is not None:
        still["block"] = trace.block[row : row + 1]
    if trace.route.shape[1]:
        still["route"] = trace.route[row : row + 1]
    if trace.obstacles.shape[1]:
        still["obstacles"] = trace.obstacles[row : row + 1]
        still["corners"] = np.array([[trace.obstacles.shape[2]]])
    facts = {**run, "format": FORMAT, "split": trace.split, "rules": trace.rules.to_table()}
    fields = {name: _lists(array) for name, array in still.items()} | {"facts": pa.array([[json.dumps(facts)]])}
    # In one column, because each column needs one or two kilobytes in the file's index.
    constants = pa.ListArray.from_arrays([0, 1], pa.StructArray.from_arrays([*fields.values()], names=[*fields]))
    batch = pa.record_batch({"constants": constants})
    yield from Chunk.from_record_batch(batch, index=None, entity_path="/exact/episode")


def _agent_name(agent: int) -> str:
    return "vehicle" if agent == 0 else f"pedestrian_{agent - 1}"


def _of_agent(
    arrays: Mapping[str, Shaped[np.ndarray, "states *_"]], agent: int
) -> Iterator[tuple[str, Shaped[np.ndarray, "states *_"]]]:
    """What the arrays of an episode say of one agent: the name and the array of each."""
    for name, array in arrays.items():
        if name in OF_VEHICLE:
            if agent == 0:
                yield name, array
        elif name not in OF_PEDESTRIANS:
            yield name, array[:, agent]
        elif agent > 0:
            yield name, array[:, agent - 1]


def _of_states(array: Shaped[np.ndarray, "time *values"], states: int) -> Shaped[np.ndarray, "states *values"]:
    """An array with a row per state.

    Args:
        array: With a row per state or per step.
        states: Number of states, one more than steps.

    Returns:
        The array; a row of NaN comes before the rows of steps, so that each is in the row of the state after the step.
    """
    if len(array) == states:
        return array
    return np.concatenate([np.full_like(array[:1], np.nan), array])


def _lists(array: Shaped[np.ndarray, "row *values"]) -> pa.ListArray:
    """An Arrow column with the values of each row as a list."""
    flat = array.reshape(len(array), -1)
    offsets = np.arange(len(flat) + 1, dtype=np.int32) * flat.shape[1]
    return pa.ListArray.from_arrays(offsets, pa.array(flat.ravel()))


def episode(found: Sequence[Chunk]) -> Episode:
    """The arrays of an episode from the chunks of its recording; empty if it has no chunks under `/exact`.

    Raises InputError where a part of it is there twice, as where recordings of one name were merged.
    """
    entities: dict[str, Episode] = {}
    for chunk in found:
        if not chunk.entity_path.startswith("/exact/"):
            continue
        batch, name = chunk.to_record_batch(), chunk.entity_path.removeprefix("/exact/")
        if name in entities:
            raise InputError(f"a recording has {name} twice: give the run.rrd of one run, not a file merged of several")
        # Columns that are not lists are Rerun's own.
        columns = {name: column for name in batch.schema.names if pa.types.is_list((column := batch[name]).type)}
        if "constants" in columns:
            constants = columns.pop("constants").flatten()
            columns |= {field.name: constants.field(field.name) for field in constants.type}
        entities[name] = {name: column.flatten().to_numpy(False) for name, column in columns.items()}
    agents = sorted((name for name in entities if _AGENT.fullmatch(name)), key=_number_of)
    moving: dict[str, list[np.ndarray]] = {}
    for agent in agents:
        for name, values in entities.pop(agent).items():
            moving.setdefault(name, []).append(values)
    together = {name: _together(values, len(moving["position"][0]) // 2) for name, values in moving.items()}
    return {name: values for entity in (*entities.values(), together) for name, values in entity.items()}


_AGENT = re.compile(r"vehicle|pedestrian_(\d+)")


def _number_of(agent: str) -> int:
    """The index of an agent in a trace, by its name."""
    return 0 if agent == "vehicle" else 1 + int(agent.removeprefix("pedestrian_"))


def _together(each: Sequence[Shaped[np.ndarray, "_"]], states: int) -> Shaped[np.ndarray, "_"]:
    """What several agents have by one name, each `[states * values]`, as formats 1 to 3 had it: state by state."""
    return np.stack([values.reshape(states, -1) for values in each], axis=1).ravel()


def facts_of(episode: Episode) -> dict[str, Any]:
    """The facts about the run that an episode contains: format, planner, scenario, rules, ..."""
    facts: dict[str, Any] = json.loads(episode["facts"][0])
    return facts


def trace(episodes: Sequence[Episode], facts: Mapping[str, Any]) -> Trace:
    """Make one trace of several episodes of a run, padded to `max_steps` and to the largest number of pedestrians.

    Args:
        episodes: The episodes.
        facts: The facts about their run.

    Returns:
        The trace, without what planners logged.
    """
    rules = Rules.of_table(facts["rules"])
    each = [_restored(episode, facts["format"]) for episode in episodes]
    case, outcome, steps = np.array([episode["case_outcome_steps"] for episode in episodes]).T.copy()
    agents, times = max(len(one["preferred_speed"]) for one in each), rules.max_steps + 1
    empty: dict[str, Any] = {
        "position": np.full((len(each), times, agents, 2), np.nan),
        "velocity": np.full((len(each), times, agents, 2), np.nan),
        "heading": np.full((len(each), times), np.nan),
        "command": np.full((len(each), times - 1, 2), np.nan),
        "gap": np.full((len(each), times - 1), np.nan),
        "wall_gap": np.full((len(each), times - 1), np.nan),
        "goal": np.zeros((len(each), times, agents, 2)),
        "radius": np.ones((len(each), times, agents)),
        "preferred_speed": np.ones((len(each), agents)),
        "present": np.zeros((len(each), times, agents), bool),
        "person": np.full((len(each), times, agents - 1), -1),
        "seen": np.zeros((len(each), times, agents - 1), bool),
    }
    for name in ("route", "obstacles"):
        empty[name] = np.full((len(each), *np.max([one[name].shape for one in each], axis=0)), np.nan)
    for name, nothing, *shape in (("undisturbed", np.nan, 2), ("perceived", np.nan, 2), ("age", np.inf), ("group", -1)):
        if name in each[0]:
            empty[name] = np.full((len(each), times, agents - 1, *shape), nothing)
    for name, filled in empty.items():
        for w, one in enumerate(each):
            values = one[name]
            part: tuple[int | slice, ...] = (w, *(slice(n) for n in values.shape))
            filled[part] = values
            # As in a rollout, goals, radii, ... of the last state are repeated beyond the end.
            if name in ("goal", "radius", "present", "person", "seen", "group"):
                filled[w, len(values) :] = filled[w, len(values) - 1]
    if "block" in episodes[0]:
        empty["block"] = np.array([int(episode["block"][0]) for episode in episodes])
    return Trace(split=facts["split"], case=case, outcome=outcome, steps=steps, rules=rules, **empty)


def _restored(episode: Episode, version: int) -> Episode:
    """The arrays of an episode in their shapes.

    Args:
        episode: The episode.
        version: Version of its format. What old formats lack is derived.

    Returns:
        Arrays `[time, ...]` by name, and the route and the obstacles.
    """
    agents, steps = len(episode["preferred_speed"]), int(episode["case_outcome_steps"][2])
    shapes: dict[str, tuple[int, ...]] = {
        "position": (agents, 2),
        "velocity": (agents, 2),
        "heading": (),
        "command": (2,),
        "gap": (),
        "wall_gap": (),
        "goal": (agents, 2),
        "radius": (agents,),
        "present": (agents,),
        "person": (agents - 1,),
        "seen": (agents - 1,),
        "undisturbed": (agents - 1, 2),
        "perceived": (agents - 1, 2),
        "age": (agents - 1,),
        "group": (agents - 1,),
    }
    found = {name: _in_time(episode[name], shape, name, steps) for name, shape in shapes.items() if name in episode}
    found["preferred_speed"] = episode["preferred_speed"]
    found["route"] = episode["route"].reshape(-1, 2) if "route" in episode else np.empty((0, 2))
    found["obstacles"] = np.empty((0, 0, 2))
    if "obstacles" in episode:
        found["obstacles"] = episode["obstacles"].reshape(-1, int(episode["corners"][0]), 2)
    if version == 1:
        found["heading"] = _heading(found["velocity"][:, 0], found["goal"][0, 0] - found["position"][0, 0])
        found["command"] = found["velocity"][1:, 0]
        found["wall_gap"] = np.full(steps, np.inf)
        found["person"] = np.where(found["present"][:, 1:], np.arange(agents - 1), -1)
        found["seen"] = found["present"][:, 1:]
    return found


def _in_time(flat: np.ndarray, shape: tuple[int, ...], name: str, steps: int) -> np.ndarray:
    """Reshape a flat array to `[time, *shape]`.

    Args:
        flat: As it was stored: once, or once per state.
        shape: Shape of one state or step.
        name: Name of the array.
        steps: Number of steps of the episode.

    Returns:
        `[time, *shape]`, where time counts states, or steps for the quantities of steps.
    """
    per_row = int(np.prod(shape))
    rows = flat.reshape(len(flat) // per_row if per_row else steps + 1, *shape)
    length = steps if name in OF_STEPS else steps + 1
    if len(rows) == 1:
        return rows.repeat(length, axis=0)
    return rows[len(rows) - length :]


def _heading(velocity: Float[np.ndarray, "time 2"], ahead: Float[np.ndarray, "2"]) -> Float[np.ndarray, "time"]:
    """The heading that the simulator gives a vehicle.

    Args:
        velocity: Its velocities in m/s.
        ahead: The vector from its start to its goal in metres.

    Returns:
        Headings in radians.
    """
    heading = np.empty(len(velocity))
    last = np.arctan2(ahead[1], ahead[0])
    for t, (vx, vy) in enumerate(velocity):
        last = heading[t] = heading_of(vx, vy, last)
    return heading
