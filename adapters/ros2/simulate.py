"""Simulates a robot with the topics of ROS 2, and scores the stack that drives it.

python adapters/ros2/simulate.py --scenario groups_12 --cases 20 --name my_stack --out runs/my_stack
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from observation_messages import (
    FRAME,
    ODOM,
    SECOND,
    clock_message,
    goal_message,
    map_message,
    observation_messages,
    state_message,
    transform_message,
    turned,
)
from topics import Topics

from crowdbench import Cases, InputError, Observation, Planner, Trace
from crowdbench.cli import announce_compilation, assignments, main, progress, say
from crowdbench.core import Pedestrians, norm
from crowdbench.runs import RunSpec, load_run, make_run
from crowdbench.utils import command, require_positive

WRITTEN = ("clock", "tf", "tf_static", "people", "odom", "scan", "map", "goal_pose", "crowdbench/state")

REPEAT = 0.5
"""Seconds after which messages are sent again, until the first command: readers may have come later."""

TICK = 0.02
"""Seconds between messages of `/clock` in real time."""


class TopicPlanner(Planner):
    """Planner that sends each observation, and receives the command of another program. For one world at a time.

    Attributes:
        latency: Seconds from each observation of the episode to the next command.
        lost: Number of observations of the episode without a command.

    Args:
        limit: Longest time in seconds without a command.
        real_time: True if the simulated time passes as the real one. A command that arrives in the first half of a step
            acts in the whole step; without one, the last command acts again.
    """

    native = True

    def __init__(self, topics: Topics, limit: float, real_time: bool) -> None:
        self.topics, self.limit, self.real_time = topics, limit, real_time
        self.now = self.start = 0
        self.latency: list[float] = []
        self.lost = 0
        self.names = Names()
        self.of_case: dict[str, Any] = {}
        self.begun = self.heard = 0.0
        self.twist: Any = None

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`. The clock never goes back: the next case starts later."""
        self.start = (self.now // SECOND + 2) * SECOND
        self.latency, self.lost, self.names = [], 0, Names()

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`. Raises InputError if no command comes."""
        step = int(obs.step[0])
        self.now = self.start + round(step * obs.dt * SECOND)
        messages = observation_messages(obs, self.names(obs.pedestrians), self.now)
        messages["crowdbench/state"] = state_message(obs, self.start, self.now, not self.real_time)
        if step == 0:
            self.of_case = _case_messages(obs, self.now)
        if self.real_time and step > 0:
            self._step_in_real_time(messages, step, obs.dt)
        else:
            self._wait_for_command(messages, is_first=step == 0)
        return self._command(obs)

    def mean_latency(self, trace: Trace) -> Float[np.ndarray, "world"]:
        """Return the mean latency of the last episode in seconds, as a metric."""
        return np.array([np.mean(self.latency) if self.latency else np.nan])

    def number_lost(self, trace: Trace) -> Float[np.ndarray, "world"]:
        """Return the number of observations of the last episode without a command, as a metric."""
        return np.array([float(self.lost)])

    def _send(self, messages: Mapping[str, Any]) -> None:
        for topic, content in messages.items():
            self.topics.write(topic, content)

    def _wait_for_command(self, messages: Mapping[str, Any], is_first: bool) -> None:
        """Send the messages of a step, again and again until a command arrives."""
        self.topics.take("cmd_vel")  # a late command of an earlier step
        sent = time.perf_counter()
        self._send({**self.of_case, **messages} if is_first else messages)
        while True:
            self.topics.wait(REPEAT)
            if self._receive():
                break
            self._check_limit(sent)
            self._send({**self.of_case, **messages})
        self.begun = self.heard
        self.latency.append(self.heard - sent)

    def _step_in_real_time(self, messages: Mapping[str, Any], step: int, dt: float) -> None:
        """Send the messages of a step at its time, and receive commands during its first half."""
        self._pass_time(step * dt)
        # The simulated time never catches up with the real one.
        sent = time.perf_counter()
        self.begun = max(self.begun, sent - step * dt)
        self._send(messages)
        self.heard, before = np.inf, self.heard
        self._pass_time((step + 0.5) * dt)
        if np.isfinite(self.heard):
            self.latency.append(self.heard - sent)
        else:
            self.lost += 1
            self.heard = before
            self._check_limit(before)

    def _pass_time(self, until: float) -> None:
        """Receive commands and send the clock until a time in seconds since the first command."""
        while (left := self.begun + until - time.perf_counter()) > 0.0:
            self.topics.wait(min(left, TICK))
            self._receive()
            passed = min(until, time.perf_counter() - self.begun)
            self.topics.write("clock", clock_message(self.start + round(passed * SECOND)))
        self._receive()

    def _receive(self) -> bool:
        """Store the last command that has arrived. Return whether there was one."""
        taken = self.topics.take("cmd_vel")
        if taken:
            self.twist, self.heard = taken[-1], time.perf_counter()
        return bool(taken)

    def _check_limit(self, since: float) -> None:
        """Raise InputError if no command has arrived for too long."""
        if time.perf_counter() - since > self.limit:
            raise InputError(
                f"no command has arrived on /cmd_vel for {self.limit:g} s: check that the stack is running"
            )

    def _command(self, obs: Observation) -> Float[np.ndarray, "1 2"]:
        """Return the command of the vehicle's dynamics, limited to its range as by the driver of a robot's base."""
        vehicle, twist = obs.vehicle, self.twist
        dynamics, fastest = vehicle.dynamics, vehicle.preferred_speed
        if dynamics.name == "holonomic":
            asked = np.array([turned((twist.linear.x, twist.linear.y), float(vehicle.heading[0]))])
            limited = asked * fastest / np.maximum(norm(asked), fastest)
        else:
            asked = np.array([[twist.linear.x, twist.angular.z]])
            limited = np.clip(asked, *dynamics.space(fastest))
        return np.where(dynamics.is_within(asked, fastest)[:, None], asked, limited)


def _case_messages(obs: Observation, now: int) -> dict[str, Any]:
    """Return the messages at the start of a case."""
    messages = {
        "tf_static": transform_message(now, FRAME, ODOM, np.zeros(2), 0.0),
        "goal_pose": goal_message(obs, now),
    }
    if np.isfinite(obs.obstacles).any():
        messages["map"] = map_message(obs.obstacles[0], now)
    return messages


class Names:
    """Names of pedestrians in consecutive observations. A pedestrian that spawns gets a new name."""

    def __init__(self) -> None:
        self.known: dict[bytes, str] = {}
        self.number = 0

    def __call__(self, crowd: Pedestrians) -> list[str]:
        """Return the names of the pedestrians that are seen."""
        names, known = [], {}
        for k in np.flatnonzero(crowd.seen[0]).tolist():
            before = crowd.history[0, -2, k].tobytes()
            name = self.known.get(before) if crowd.observed[0, k] > 1 else None
            if name is None:
                name, self.number = str(self.number), self.number + 1
            names.append(name)
            known[crowd.history[0, -1, k].tobytes()] = name
        self.known = known
        return names


def simulate(
    name: Annotated[str, typer.Option()],
    out: Annotated[Path, typer.Option()],
    scenario: str = "circle_crossing_5",
    cases: str = "20",
    overrides: list[str] | None = None,
    real_time: bool = False,
    limit: float = 30.0,
    overwrite: bool = False,
) -> None:
    """Simulate a robot that a stack of ROS 2 drives, and write the run.

    Args:
        name: The name of the stack in tables. An interrupted run with the same name continues.
        out: The directory of the run.
        cases: Number of test cases, or cases such as val:20.
        real_time: Simulate in real time. By default, each step waits for a command.
        limit: Longest time in seconds without a command.
    """
    require_positive("--limit", limit)
    settings = {"real_time": True} if real_time else {}
    spec = RunSpec(
        name,
        scenario,
        Cases.parse(cases),
        options=settings,
        overrides=assignments(overrides or [], "--set"),
        batch=1,
        decision_limit=limit + 60.0,
    )
    announce_compilation()
    planner = TopicPlanner(Topics(WRITTEN, ["cmd_vel"]), limit, real_time)
    run = load_run(spec, planner, key=f"{name} {settings}")
    if run.scenario.rules.dynamics.name == "bicycle":
        raise InputError(f"{scenario} has a bicycle, but /cmd_vel is for holonomic vehicles and unicycles")
    metrics = {**run.metrics, "command_latency": planner.mean_latency, "commands_lost": planner.number_lost}
    run = dataclasses.replace(run, metrics=metrics)
    with progress(len(spec.cases)) as report:
        make_run(run, out, overwrite=overwrite, progress=report)
    say(f"wrote {out}\n  {command('score', out)}\n  {command('view', out)}")


if __name__ == "__main__":
    main(simulate)
