"""The part of a recording that is read back: episodes in full precision, under `/exact`, which no view shows.

`/exact/vehicle`, `/exact/pedestrian_0`, ... have a row per state, with the quantities that change in the episode. A
quantity of a step is in the row of the state after the step. `/exact/episode` has one row with the constants.
Measurements of the vehicle are recorded if its sensor is limited, groups if the scenario has them.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Shaped
from rerun.chunk import Chunk, RrdReader, StoreEntry

from crowdbench.core.geometry import pad_arrays, pad_points
from crowdbench.core.types import Rules, Trace
from crowdbench.record import rrd
from crowdbench.utils.errors import InputError

FORMAT = 1
"""Version of the format of the data under `/exact`."""


class Quantity(NamedTuple):
    """Description of an array of a trace: its agents, its padding and its shape.

    Attributes:
        of: The agents that have it.
        padding: Value for absent agents, and after the end of an episode.
        shape: Its shape in one state of one agent.
        is_of_steps: True if it has a value per step, False if it has a value per state.
        is_held: True if the last state is repeated after the end of an episode, as in a rollout.
    """

    of: slice
    padding: float
    shape: tuple[int, ...] = ()
    is_of_steps: bool = False
    is_held: bool = False


AGENTS, VEHICLE, PEDESTRIANS = slice(0, None), slice(0, 1), slice(1, None)

QUANTITIES = {
    "position": Quantity(AGENTS, np.nan, (2,)),
    "velocity": Quantity(AGENTS, np.nan, (2,)),
    "heading": Quantity(VEHICLE, np.nan),
    "goal": Quantity(AGENTS, 0.0, (2,), is_held=True),
    "radius": Quantity(AGENTS, 1.0, is_held=True),
    "present": Quantity(AGENTS, False, is_held=True),
    "person": Quantity(PEDESTRIANS, -1, is_held=True),
    "seen": Quantity(PEDESTRIANS, False, is_held=True),
    "command": Quantity(VEHICLE, np.nan, (2,), is_of_steps=True),
    "gap": Quantity(VEHICLE, np.nan, is_of_steps=True),
    "wall_gap": Quantity(VEHICLE, np.nan, is_of_steps=True),
    "undisturbed": Quantity(PEDESTRIANS, np.nan, (2,)),
    "perceived": Quantity(PEDESTRIANS, np.nan, (2,)),
    "age": Quantity(PEDESTRIANS, np.inf),
    "group": Quantity(PEDESTRIANS, -1, is_held=True),
    "noticed": Quantity(PEDESTRIANS, False, is_held=True),
}
"""The arrays of a trace that are recorded for every state or step, by name."""

Episode = dict[str, np.ndarray]
"""Arrays of one episode by name, each with one axis."""


@dataclass(frozen=True)
class Recording:
    """Content of a file.

    Attributes:
        trace: The recorded episodes, ordered by case.
        planner: The planner's name with its options.
        scenario: The scenario's name.
        scenario_digest: The scenario's digest.
        cases: Number of cases of the whole run, recorded or not.
    """

    trace: Trace
    planner: str
    scenario: str
    scenario_digest: str
    cases: int


class RecordedEpisode(NamedTuple):
    """An episode as it is in a file.

    Attributes:
        entry: Its name in the file.
        chunks: All its chunks.
        trace: The episode.
        planner: The planner's name with its options.
    """

    entry: StoreEntry
    chunks: list[Chunk]
    trace: Trace
    planner: str


def to_chunks(trace: Trace, row: int, run: Mapping[str, Any]) -> Iterator[Chunk]:
    """Yield one episode as Rerun chunks: of the agents, and of `/exact/episode`.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        run: Facts about the whole run, of JSON types.
    """
    steps, dt = int(trace.steps[row]), trace.rules.dt
    arrays = {
        name: getattr(trace, name)[row, : steps if quantity.is_of_steps else steps + 1]
        for name, quantity in QUANTITIES.items()
        if getattr(trace, name) is not None
    }
    # The position always counts as changing, so that each agent has a column.
    still = {name: array[:1] for name, array in arrays.items() if name != "position" and (array == array[:1]).all()}
    moving = {name: _pad_start(array, steps + 1) for name, array in arrays.items() if name not in still}
    [time] = rrd.moments(np.arange(steps + 1), dt)
    agents = range(trace.position.shape[2])
    for agent in agents:
        columns = {"time": time.as_arrow_array()}
        for name, array in moving.items():
            of = QUANTITIES[name].of
            if agent in agents[of]:
                columns[name] = _to_lists(array if of == VEHICLE else array[:, agent - of.start])
        entity = f"/exact/{_agent_name(agent)}"
        yield from Chunk.from_record_batch(pa.record_batch(columns), index=["time"], entity_path=entity)
    one = slice(row, row + 1)
    still["preferred_speed"] = trace.preferred_speed[one]
    still["case_outcome_steps"] = np.array([[trace.case[row], trace.outcome[row], trace.steps[row]]])
    more = {"block": trace.block, "route": trace.route, "obstacles": trace.obstacles}
    still |= {name: array[one] for name, array in more.items() if array is not None and array[one].size}
    if "obstacles" in still:
        still["corners"] = np.array([[trace.obstacles.shape[2]]])
    facts = {**run, "format": FORMAT, "split": trace.split, "rules": trace.rules.to_table()}
    fields = {name: _to_lists(array) for name, array in still.items()} | {"facts": pa.array([[json.dumps(facts)]])}
    # In one column, because each column needs one or two kilobytes in the file's index.
    constants = pa.ListArray.from_arrays([0, 1], pa.StructArray.from_arrays([*fields.values()], names=[*fields]))
    batch = pa.record_batch({"constants": constants})
    yield from Chunk.from_record_batch(batch, index=None, entity_path="/exact/episode")


def _agent_name(agent: int) -> str:
    return "vehicle" if agent == 0 else f"pedestrian_{agent - 1}"


def _pad_start(array: Shaped[np.ndarray, "time *values"], states: int) -> Shaped[np.ndarray, "states *values"]:
    """Return an array with a row per state: NaN before the first step, so that each step is in the row of the state
    after it."""
    return array if len(array) == states else np.concatenate([np.full_like(array[:1], np.nan), array])


def _to_lists(array: Shaped[np.ndarray, "row *values"]) -> pa.ListArray:
    """Return an Arrow column with the values of each row as a list."""
    flat = array.reshape(len(array), -1)
    offsets = np.arange(len(flat) + 1, dtype=np.int32) * flat.shape[1]
    return pa.ListArray.from_arrays(offsets, pa.array(flat.ravel()))


def read(path: Path) -> Recording:
    """Read the episodes of a file, without planners' logs. They equal the recorded episodes to the last bit.

    Raises InputError if the file does not exist, is incomplete, or was not written by this version of crowdbench.
    """
    with rrd.opening(path):
        reader = RrdReader(path)
        episodes = [_to_episode(rrd.chunks_of(reader, entry, "/exact/**")) for entry in reader.recordings()]
        trace, facts = _to_trace(path, episodes)
        return Recording(trace, **{name: facts[name] for name in ("planner", "scenario", "scenario_digest", "cases")})


def read_episode(path: Path, reader: RrdReader, entry: StoreEntry) -> RecordedEpisode:
    """Read one of the recordings in a file. Raises InputError as `read` does.

    Args:
        path: The file.
        reader: Its reader.
        entry: The recording.
    """
    with rrd.opening(path):
        chunks = rrd.chunks_of(reader, entry, "/**")
        trace, facts = _to_trace(path, [_to_episode(chunks)])
        return RecordedEpisode(entry, chunks, trace, facts["planner"])


def read_facts(path: Path, reader: RrdReader, entry: StoreEntry) -> dict[str, str]:
    """Read the planner, the scenario and its digest of a recording in a file. Raises InputError as `read` does.

    Args:
        path: The file.
        reader: Its reader.
        entry: The recording.
    """
    with rrd.opening(path):
        facts = json.loads(_to_episode(rrd.chunks_of(reader, entry, "/exact/episode"))["facts"][0])
        return {name: facts[name] for name in ("planner", "scenario", "scenario_digest")}


def _to_episode(chunks: Sequence[Chunk]) -> Episode:
    """Return the arrays of an episode from the chunks of its recording; empty if it has no chunks under `/exact`.

    Raises InputError if a part exists twice, for example after a merge of recordings with the same name.
    """
    entities: dict[str, Episode] = {}
    for chunk in chunks:
        if not chunk.entity_path.startswith("/exact/"):
            continue
        batch, name = chunk.to_record_batch(), chunk.entity_path.removeprefix("/exact/")
        if name in entities:
            raise InputError(f"a recording has {name} twice: give the run.rrd of one run, not a file merged of several")
        # Columns that are not lists are internal to Rerun.
        columns = {name: column for name in batch.schema.names if pa.types.is_list((column := batch[name]).type)}
        if "constants" in columns:
            constants = columns.pop("constants").flatten()
            columns |= {field.name: constants.field(field.name) for field in constants.type}
        entities[name] = {name: column.flatten().to_numpy(False) for name, column in columns.items()}
    moving: dict[str, list[np.ndarray]] = {}
    for agent in itertools.takewhile(entities.__contains__, map(_agent_name, itertools.count())):
        for name, values in entities.pop(agent).items():
            moving.setdefault(name, []).append(values)
    states = len(moving["position"][0]) // 2 if moving else 0
    together = {
        name: np.stack([values.reshape(states, -1) for values in by_agent], axis=1).ravel()
        for name, by_agent in moving.items()
    }
    return {name: values for entity in (*entities.values(), together) for name, values in entity.items()}


def _to_trace(path: Path, episodes: Sequence[Episode]) -> tuple[Trace, dict[str, Any]]:
    """Return one trace of the episodes of a file, sorted by case and padded to `max_steps` and to the largest number of
    pedestrians.

    Raises InputError if they were not written by crowdbench, belong to several runs, or have another format.

    Returns:
        The trace, without planners' logs, and the facts about the run: planner, scenario, ...
    """
    if not episodes or not all("facts" in episode for episode in episodes):
        raise rrd.foreign(path)
    facts, *others = (json.loads(episode["facts"][0]) for episode in episodes)
    if any(other != facts for other in others):
        raise InputError(f"{path} mixes several runs: give one run's own run.rrd")
    if facts["format"] != FORMAT:
        raise InputError(
            f"{path} is a recording of format {facts['format']}, but this version of crowdbench reads format {FORMAT}: "
            "record the run again, or read it with the version that wrote it"
        )
    episodes = sorted(episodes, key=lambda episode: int(episode["case_outcome_steps"][0]))
    case, outcome, steps = np.array([episode["case_outcome_steps"] for episode in episodes]).T.copy()
    rules = Rules.of_table(facts["rules"])
    arrays: dict[str, Any] = {}
    for name, quantity in QUANTITIES.items():
        if name not in episodes[0]:
            continue
        times = rules.max_steps if quantity.is_of_steps else rules.max_steps + 1
        in_time = [_in_time(episode, name, times) for episode in episodes]
        padded = pad_arrays(in_time, quantity.padding, times)
        arrays[name] = padded[:, :, 0] if quantity.of == VEHICLE else padded
    arrays["preferred_speed"] = pad_arrays([episode["preferred_speed"] for episode in episodes], 1.0)
    arrays["route"] = pad_points([episode.get("route", np.empty(0)).reshape(-1, 2) for episode in episodes])
    arrays["obstacles"] = pad_arrays([_obstacles(episode) for episode in episodes], np.nan)
    if "block" in episodes[0]:
        arrays["block"] = np.array([int(episode["block"][0]) for episode in episodes])
    return Trace(split=facts["split"], case=case, outcome=outcome, steps=steps, rules=rules, **arrays), facts


def _in_time(episode: Episode, name: str, times: int) -> Shaped[np.ndarray, "time agent *values"]:
    """Return an array of an episode, stored once or once per state, in its shape; held arrays get `times` rows."""
    quantity, flat = QUANTITIES[name], episode[name]
    agents, steps = len(episode["preferred_speed"]), int(episode["case_outcome_steps"][2])
    shape = len(range(agents)[quantity.of]), *quantity.shape
    per_row, length = math.prod(shape), steps if quantity.is_of_steps else steps + 1
    rows = flat.reshape(len(flat) // per_row if per_row else steps + 1, *shape)
    rows = rows.repeat(length, axis=0) if len(rows) == 1 else rows[len(rows) - length :]
    return rows[np.minimum(np.arange(times), length - 1)] if quantity.is_held else rows


def _obstacles(episode: Episode) -> Float[np.ndarray, "polygon corner 2"]:
    if "obstacles" not in episode:
        return np.empty((0, 0, 2))
    return episode["obstacles"].reshape(-1, int(episode["corners"][0]), 2)
