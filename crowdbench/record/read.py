"""Reads traces back from recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rerun.chunk import RrdReader

from crowdbench.errors import InputError
from crowdbench.record import exact, rrd
from crowdbench.types import Trace


@dataclass(frozen=True)
class Recording:
    """What a file holds.

    Attributes:
        trace: The recorded episodes, ordered by case.
        planner: The planner's name with its options.
        scenario: The scenario's name.
        scenario_digest: The scenario's digest.
        cases: How many cases the whole run has, recorded or not.
    """

    trace: Trace
    planner: str
    scenario: str
    scenario_digest: str
    cases: int


def read(path: Path) -> Recording:
    """Read the episodes of a file, equal to those that were recorded to the last bit, without what planners logged.

    Raises InputError where the file does not exist, is incomplete, or was not written by crowdbench.
    """
    with rrd.opening(path):
        reader = RrdReader(path)
        episodes = [exact.episode(rrd.chunks_of(reader, entry, "/exact/**")) for entry in reader.recordings()]
    if not episodes or not all(episodes):
        raise rrd.foreign(path)
    facts, *others = map(exact.facts_of, episodes)
    if any(other != facts for other in others) or facts["format"] not in exact.READABLE:
        raise InputError(
            f"{path} mixes several runs or was written by a newer version of crowdbench: give one run's own run.rrd"
        )
    episodes.sort(key=lambda episode: int(episode["case_outcome_steps"][0]))
    run = {name: facts[name] for name in ("planner", "scenario", "scenario_digest", "cases")}
    return Recording(exact.trace(episodes, facts), **run)
