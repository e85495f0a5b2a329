"""Rollouts of recorded windows with cars: the nearest car is the vehicle, all cars drive as recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench import World
from crowdbench.plugins import plugin_name
from crowdbench.scenario import ETH_UCY_DT
from crowdbench.sim import Recorded, init_memories
from studies.people.cars import DISCS, CarWindow, discs_of, pose, rim_distance, time_to_collision
from studies.people.encounters import Places
from studies.people.likelihood import THIRDS, WindowScore, log_event, log_motion, log_value, make_score
from studies.people.placeholder import FAR
from studies.people.simulate import MOST_WORLDS, ROLLOUTS, Rollouts, load_policy, start_worlds, walk
from studies.people.windows import HISTORY, Window, batches, make_window

SCENARIO = Path(__file__).with_name("traffic.toml")

RECORDED = "recorded"
"""The policy of the discs of cars that are not the vehicle."""

FASTEST = 100.0
"""Preferred speed in m/s of these discs, which never limits them."""


def simulate_traffic(
    policy: str,
    windows: Sequence[CarWindow],
    options: Mapping[str, Any] | None = None,
    *,
    hidden: bool = False,
    rollouts: int = ROLLOUTS,
) -> Rollouts:
    """Simulate windows with cars several times; see `simulate`.

    The first car of a window is the vehicle, which pedestrians see. Others are discs that pedestrians avoid.
    """
    scenario = load_policy(policy, _with_attention(policy, options or {}), SCENARIO)
    policies = {**scenario.policies, RECORDED: Recorded()}
    positions: Rollouts = []
    for batch in batches(windows, max(1, MOST_WORLDS // rollouts)):
        world = start_worlds(scenario, [with_discs(each) for each in batch], hidden, rollouts)
        world = _with_recorded_discs(world, batch, rollouts)
        vehicle = _Vehicles(batch, rollouts, world.rules.dt)
        world = init_memories(vehicle.place(world), policies)
        places = walk(world, policies, vehicle.place)
        shape = len(batch), rollouts, *places.shape[1:]
        for each, place in zip(batch, places.reshape(shape), strict=True):
            positions.append(place[:, :, : len(each.window.group)])
    return positions


def _with_attention(policy: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with the attention that the policy brings, which replaces that of the scenario."""
    own = load_policy(policy, options, SCENARIO).policies[plugin_name(policy)].attention
    return {**{f"pedestrians.attention.{key}": value for key, value in own.items()}, **options}


def with_discs(car_window: CarWindow) -> Window:
    """Return a window in which the discs of all cars but the first one are further persons, that are not scored."""
    window = car_window.window
    times = car_window.start + ETH_UCY_DT * np.arange(-HISTORY, len(window.future))
    discs = discs_of(car_window.cars[1:], times).position
    if not discs.shape[1]:
        return window
    ends = np.array([path[np.isfinite(path[:, 0])][-1] for path in discs.swapaxes(0, 1)]).reshape(-1, 2)
    group = np.append(window.group, window.group.max() + 1 + np.arange(len(ends)))
    position = np.concatenate([window.position, discs], axis=1)
    made = make_window(window.name, window.number, position, group, np.concatenate([window.end, ends]))
    return dataclasses.replace(made, scored=np.append(window.scored, np.zeros(len(ends), bool)))


def score_traffic(windows: Sequence[CarWindow], rollouts: Sequence[Places]) -> list[WindowScore]:
    """Return the score of rollouts in each window, of persons near a moving car; contacts are with cars."""
    return [_score_window(window, places) for window, places in zip(windows, rollouts, strict=True)]


def _score_window(car_window: CarWindow, places: Places) -> WindowScore:
    window, discs, persons = car_window.window, car_window.discs, car_window.near
    chosen, truth = places[:, :, persons], window.future[None][:, :, persons]
    rim, recorded_rim = rim_distance(chosen, discs), rim_distance(truth, discs)[0]
    time, recorded_time = time_to_collision(chosen, discs), time_to_collision(truth, discs)[0]
    of_person = log_motion(window, places, persons) | {
        "rim": log_value("rim", rim, recorded_rim),
        "time to collision": log_value("time to collision", time, recorded_time),
        "struck": log_event(rim < 0.0, recorded_rim < 0.0),
    }
    features = {**THIRDS, "encounter": ("rim", "time to collision", "struck")}
    return make_score(of_person, features, persons[persons], (rim, recorded_rim), limit=0.0)


def _with_recorded_discs(world: World, windows: Sequence[CarWindow], rollouts: int) -> World:
    """Return worlds in which the persons that are discs of cars drive as recorded, with their radius."""
    policy, radius, speed = world.policy.copy(), world.radius.copy(), world.preferred_speed.copy()
    for number, each in enumerate(windows):
        rows, first = slice(number * rollouts, (number + 1) * rollouts), len(each.window.group)
        widths = np.repeat([car.width / 2.0 for car in each.cars[1:]], DISCS)
        policy[rows, first:] = len(world.parameters)
        radius[rows, 1 + first : 1 + first + len(widths)] = widths
        speed[rows, 1 + first :] = FASTEST
    parameters = {**world.parameters, RECORDED: {}}
    return world.replace(
        policy=policy,
        radius=radius,
        preferred_speed=speed,
        parameters=parameters,
        memory={name: {} for name in parameters},
    )


class _Vehicles:
    """Recorded motion of the vehicle of each world."""

    def __init__(self, windows: Sequence[CarWindow], rollouts: int, dt: float) -> None:
        poses = [pose(each.cars[0], each.times(dt)) for each in windows]
        position, heading = (np.stack(values) for values in zip(*poses, strict=True))
        velocity = np.diff(position, axis=1, append=position[:, -1:]) / dt
        here = np.isfinite(heading)
        # While it is absent, it stands far away.
        self.position = np.repeat(np.where(here[..., None], position, FAR), rollouts, axis=0)
        self.velocity = np.repeat(np.nan_to_num(velocity), rollouts, axis=0)
        self.heading = np.repeat(np.nan_to_num(heading), rollouts, axis=0)

    def place(self, world: World) -> World:
        """Return worlds in which the vehicle is where it was recorded."""
        step = int(world.step[0])
        position, velocity = world.position.copy(), world.velocity.copy()
        position[:, 0], velocity[:, 0] = self.position[:, step], self.velocity[:, step]
        return world.replace(position=position, velocity=velocity, heading=self.heading[:, step])
