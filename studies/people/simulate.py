"""Rollouts of recorded windows: pedestrians of a policy start, come and go as recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench import InputError, PedestrianPolicy, Scenario, World, load_scenario
from crowdbench.core import HISTORY as STATES
from crowdbench.core import pad_arrays
from crowdbench.plugins import plugin_name
from crowdbench.scenario import ETH_UCY_DT
from crowdbench.sim import come_and_go, crowd_decisions, init_memories, step_pedestrians
from studies.people.windows import HISTORY, Window, batches

SCENARIO = Path(__file__).with_name("window.toml")

ROLLOUTS = 32

Speeds = Float[np.ndarray, "world agent"]

OF_EVERYBODY = ("radius", "preferred_speed", "inertia")
"""Quantities with a spread that do not depend on the policy."""

MIN_SPEED = 1e-3
"""Smallest preferred speed in m/s, for persons that stood still."""

MOST_ROLLOUTS = 1000
"""More than any number of rollouts. A case is the number of a window times this number, plus that of a rollout."""

MOST_PERSONS = 100
"""Largest number of persons in a window. So many are drawn for each window: a draw depends on their number."""

MOST_WORLDS = 1024
"""Worlds of a batch: their arrays take some 100 MB."""

Rollouts = list[Float[np.ndarray, "rollout time person 2"]]
"""By window, positions in metres in its frames from the start on; NaN for absent persons."""


def simulate(
    policy: str,
    windows: Sequence[Window],
    options: Mapping[str, Any] | None = None,
    *,
    hidden: bool = False,
    rollouts: int = ROLLOUTS,
) -> Rollouts:
    """Simulate windows several times. A window gives the same rollouts alone and in any batch.

    Args:
        policy: The name of a pedestrian policy, or a file with one.
        windows: The windows.
        options: Parameters of the policy by name, and keys of the scenario that start with `pedestrians.`.
        hidden: True if pedestrians walk to an extrapolated goal.
        rollouts: Number of rollouts.

    Raises:
        InputError: There is no such policy, an option is wrong, or the policy fails.
    """
    scenario = load_policy(policy, options or {})
    positions: Rollouts = []
    for batch in batches(windows, max(1, MOST_WORLDS // rollouts)):
        places = walk(start_worlds(scenario, batch, hidden, rollouts), scenario.policies)
        shape = len(batch), rollouts, *places.shape[1:]
        for window, place in zip(batch, places.reshape(shape), strict=True):
            positions.append(place[:, :, : len(window.group)])
    return positions


def load_policy(policy: str, options: Mapping[str, Any], file: Path = SCENARIO) -> Scenario:
    """Return the scenario of windows for a policy with its options. Raises InputError if one is wrong."""
    name = plugin_name(policy)
    changes = {key if key.startswith("pedestrians.") else f"pedestrians.{name}.{key}": options[key] for key in options}
    scenario = load_scenario(str(file), {"pedestrians.number": MOST_PERSONS, **changes}, pedestrians=policy)
    if scenario.crowd.stands.any():
        raise InputError(f"the pedestrians of {name} always stand: only policies that walk are scored")
    return scenario


def population_options(policy: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with which another policy has the radius and the population of a policy with its options.

    Parameters of the policy do not vary then, because the other one may lack them. Without a population there are none.
    """
    scenario = load_policy(policy, options)
    for population in scenario.crowd.variation.values():
        spread = {name: sigma for name, sigma in population.spread.items() if name in OF_EVERYBODY}
        table = {**population.model_dump(), "spread": spread}
        return {"pedestrians.radius": scenario.table["pedestrians"]["radius"], "pedestrians.population": table}
    return {}


def walk(
    world: World, policies: Mapping[str, PedestrianPolicy], before: Callable[[World], World] | None = None
) -> Float[np.ndarray, "world time person 2"]:
    """Simulate worlds until the end of their tracks.

    Args:
        world: The worlds at their start.
        policies: The policies by name.
        before: A change before each step, such as motion of the vehicle.

    Returns:
        Positions in metres in the frames of the recording; NaN for absent persons.
    """
    every, positions = round(ETH_UCY_DT / world.rules.dt), []
    for step in range(world.track.shape[1]):
        if step % every == 0:
            positions.append(np.where(world.present[:, 1:, None], world.position[:, 1:], np.nan))
        crowd, world = crowd_decisions(world if before is None else before(world), policies)
        world = step_pedestrians(world, crowd, come_and_go)
    return np.stack(positions, axis=1)


def start_worlds(scenario: Scenario, windows: Sequence[Window], hidden: bool, rollouts: int) -> World:
    """Return worlds at the start of windows: for each window one for each rollout."""
    # The numbers of cases, from which random numbers derive, do not depend on the other windows.
    cases = np.array([MOST_ROLLOUTS * window.case + rollout for window in windows for rollout in range(rollouts)])
    drawn = scenario.draw("test", cases)
    people = max(len(window.group) for window in windows)
    if people > MOST_PERSONS:
        raise InputError(f"a window has {people} persons, but at most {MOST_PERSONS} can be simulated")

    def of_agents(array: np.ndarray) -> np.ndarray:
        return array[:, : people + 1].copy()

    def stack(arrays: Iterable[np.ndarray], padding: float) -> np.ndarray:
        return np.repeat(pad_arrays(list(arrays), padding), rollouts, axis=0)

    def with_vehicle(vehicle: np.ndarray, arrays: Iterable[np.ndarray], padding: float) -> np.ndarray:
        return np.concatenate([vehicle[:, :1], stack(arrays, padding)], axis=1)

    fine = [_refine(window.position, round(ETH_UCY_DT / scenario.rules.dt)) for window in windows]
    now = round(HISTORY * ETH_UCY_DT / scenario.rules.dt)
    track = stack((path[now:] for path in fine), np.nan)
    speed = with_vehicle(drawn.preferred_speed, (np.maximum(window.speed, MIN_SPEED) for window in windows), 1.0)
    world = World.create(
        case=drawn.case,
        key=drawn.key,
        noise_key=drawn.noise_key,
        position=with_vehicle(drawn.position, (window.first for window in windows), 0.0),
        velocity=with_vehicle(drawn.velocity, (window.velocity for window in windows), 0.0),
        goal=with_vehicle(drawn.goal, (window.goals(hidden=hidden) for window in windows), 0.0),
        radius=of_agents(drawn.radius),
        preferred_speed=_vary(scenario, of_agents(drawn.preferred_speed), speed),
        present=np.concatenate([drawn.present[:, :1], np.isfinite(track[:, 0, :, 0])], axis=1),
        person=drawn.person[:, :people].copy(),
        policy=drawn.policy[:, :people].copy(),
        track=track,
        history=stack((_fill(path)[now + 1 - STATES : now + 1] for path in fine), 0.0),
        parameters={
            name: {key: of_agents(values) for key, values in table.items()} for name, table in drawn.parameters.items()
        },
        rules=scenario.rules,
    )
    return init_memories(world, scenario.policies)


def _vary(scenario: Scenario, drawn: Speeds, recorded: Speeds) -> Speeds:
    """Return recorded preferred speeds as the population of the scenario varies them, if it has one.

    Args:
        scenario: The scenario.
        drawn: The speeds in m/s that it has drawn: 1 m/s, varied.
        recorded: The recorded speeds in m/s.
    """
    for population in scenario.crowd.variation.values():
        # Shrinkage, then a factor for each person.
        return drawn / population.shrink(1.0) * population.shrink(recorded)
    return recorded


def _refine(path: Float[np.ndarray, "time person 2"], parts: int) -> Float[np.ndarray, "moment person 2"]:
    """Return positions at `parts` times as many moments, linear between frames; NaN unless both are known."""
    fine = np.full((parts * (len(path) - 1) + 1, *path.shape[1:]), np.nan)
    for part in range(1, parts):
        fine[part::parts] = path[:-1] + part / parts * np.diff(path, axis=0)
    fine[::parts] = path
    return fine


def _fill(path: Float[np.ndarray, "time person 2"]) -> Float[np.ndarray, "time person 2"]:
    """Return positions with each person's first one repeated before it."""
    first = np.isfinite(path[..., 0]).argmax(axis=0)
    before = np.arange(len(path))[:, None] < first
    return np.where(before[..., None], path[first, np.arange(path.shape[1])], path)
