"""How long a step takes where the vehicle's sight is limited."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import in_turns
from crowdbench.catalog import load_scenario
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step

SCENARIO = "circle_crossing_limited_sight"

SENSORS: Mapping[str, Mapping[str, Any]] = {
    "perfect sight": {"sensor": {}},
    "limited sight": {},
    "limited sight and a lidar of 360 beams": {"sensor.lidar": {"beams": 360, "range": 10.0}},
}
"""The sensors that are compared, as changes of the scenario."""

STEPS = 28


def measure_sight() -> Iterator[Measurement]:
    """A step with the observation before it, among ten pedestrians: with perfect and with limited sight."""
    scenarios = [load_scenario(SCENARIO, changes) for changes in SENSORS.values()]
    for worlds, name, rounds in ((1, "one world", 30), (1000, "1,000 worlds, per world-step", 5)):
        took = in_turns(rounds, *(functools.partial(observed_steps, each, worlds) for each in scenarios))
        for sensor, seconds in zip(SENSORS, took, strict=True):
            yield Measurement(
                f"processor time of a step and its observation, 10 pedestrians, {name}: {sensor}", 1e6 * seconds, "us"
            )


def observed_steps(scenario: Scenario, worlds: int) -> float:
    """Seconds of processor time per step and world, in which the vehicle drives on and observes.

    Args:
        scenario: The scenario.
        worlds: Number of worlds.
    """
    now = scenario.worlds(Cases("test", 0, worlds))
    command = np.tile([0.0, 0.5], (worlds, 1))
    begin = time.process_time()
    for _ in range(STEPS):
        crowd = crowd_velocities(now, scenario.policies)
        observe(now)
        now, _ = step(now, command, crowd)
    return (time.process_time() - begin) / (STEPS * worlds)
