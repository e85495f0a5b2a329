"""The nonlinear program of model predictive control, as CasADi builds it for IPOPT."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from crowdbench import InputError
from crowdbench.core import Dynamics, Holonomic, Unicycle
from crowdbench.utils import require_not_negative

PEOPLE, WALLS = 12, 6
"""How many pedestrians and edges of obstacles a program has room for, the nearest ones."""

DISCS = 3
"""How many discs stand for a long body at most: the first, the last, and one between."""


@dataclasses.dataclass(frozen=True)
class Terms:
    """Weights of a program.

    Attributes:
        change: A change of a command by its whole range, squared [m].
        near: Cost of violating the margin to a pedestrian, per metre plus per square metre [1].
        fading: Factor of `near` for each step ahead, because the prediction is less certain [1].
        wall: The same of the margin to an obstacle [1].
        margin: Distance to people that is to be kept [m].
        growth: Increase of the margin for each second ahead [m/s].
        sigma_factor: Standard deviations of future positions by which a filter enlarges people's radii [1].

    Raises:
        InputError: A number is impossible.
    """

    change: float = 0.3
    near: float = 300.0
    fading: float = 0.7
    wall: float = 300.0
    margin: float = 0.15
    growth: float = 0.35
    sigma_factor: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_not_negative(name, value)


TERMS = Terms()

Commands = Float[np.ndarray, "time 2"]


class Program(NamedTuple):
    """A program that is ready to be solved for any situation.

    Attributes:
        solve: CasADi's solver. It finds the commands, and after them two slacks for each step: to people and to walls.
        horizon: Number of steps.
    """

    solve: Callable[..., Any]
    horizon: int

    def run(
        self, guess: Commands, bounds: tuple[np.ndarray, np.ndarray], situation: Float[np.ndarray, "number"]
    ) -> Commands:
        """Return the commands that are found.

        Args:
            guess: Those from which it starts.
            bounds: The lowest and the highest of each number of a command.
            situation: See `_situation`.
        """
        slacks = np.zeros(2 * self.horizon)
        low, high = (np.tile(bound, self.horizon) for bound in bounds)
        found = self.solve(
            x0=np.append(guess.ravel(), slacks + 0.5),
            lbx=np.append(low, slacks),
            ubx=np.append(high, slacks + np.inf),
            lbg=0.0,
            ubg=np.inf,
            p=situation,
        )
        best: np.ndarray = np.array(found["x"]).ravel()[: 2 * self.horizon].reshape(self.horizon, 2)
        return best


@functools.lru_cache(maxsize=8)
def build_program(
    dynamics: Dynamics, body: tuple[float, ...], dt: float, horizon: int, terms: Terms, iterations: int
) -> Program:
    """Make the program of a vehicle.

    Args:
        dynamics: How it moves.
        body: Where its discs are, in metres ahead of its position.
        dt: Length of a step in seconds.
        horizon: Number of steps.
        terms: Its weights.
        iterations: Of IPOPT, at most.
    """
    ca = import_casadi()
    commands = ca.SX.sym("commands", 2, horizon)
    near, touch = ca.SX.sym("near", horizon), ca.SX.sym("touch", horizon)
    now, own = ca.SX.sym("now", 6), ca.SX.sym("own", 4)
    people, edges = ca.SX.sym("people", 3, PEOPLE * horizon), ca.SX.sym("edges", 4, WALLS)
    goal, radius, speed = own[:2], own[2], own[3]
    pose, cost, kept = now[[0, 1, 4]], 0.0, []
    before = _driven(ca, dynamics, now)
    span = ca.vertcat(speed, speed if isinstance(dynamics, Holonomic) else dynamics.limits[1])
    discs = body if len(body) <= DISCS else tuple(np.linspace(body[0], body[-1], DISCS).tolist())
    for t in range(horizon):
        command = commands[:, t]
        cost += terms.change * ca.sumsqr((command - before) / span)
        kept += _limits(ca, dynamics, command, before, speed, dt)
        pose, before = _move(ca, dynamics, pose, command, dt), command
        x, y, heading = pose[0], pose[1], pose[2]
        cost += dt * ca.sqrt((x - goal[0]) ** 2 + (y - goal[1]) ** 2 + 1e-4)
        cost += terms.near * terms.fading**t * (near[t] + near[t] ** 2) + terms.wall * (touch[t] + touch[t] ** 2)
        margin = terms.margin + terms.growth * dt * t
        for ahead in discs:
            px, py = x + ahead * ca.cos(heading), y + ahead * ca.sin(heading)
            for p in range(PEOPLE):
                other = people[:, t * PEOPLE + p]
                away = ca.sqrt((px - other[0]) ** 2 + (py - other[1]) ** 2 + 1e-6)
                kept.append(away - radius - other[2] - margin + near[t])
            for k in range(WALLS):
                kept.append(_to_edge(ca, px, py, edges[:, k]) - radius - 0.02 + touch[t])
    parameters = ca.vertcat(now, own, ca.reshape(people, -1, 1), ca.reshape(edges, -1, 1))
    unknown = ca.vertcat(ca.reshape(commands, -1, 1), near, touch)
    options = {"ipopt.max_iter": iterations, "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    # A small barrier, so that it stays near its start, which is a good one.
    options |= {"ipopt.mu_init": 1e-2, "ipopt.tol": 1e-3, "ipopt.acceptable_tol": 1e-2, "ipopt.acceptable_iter": 3}
    problem = {"x": unknown, "p": parameters, "f": cost, "g": ca.vertcat(*kept)}
    return Program(ca.nlpsol("mpc", "ipopt", problem, options), horizon)


def _driven(ca: Any, dynamics: Dynamics, now: Any) -> Any:
    """Return the command that the vehicle has followed in the last step."""
    if isinstance(dynamics, Holonomic):
        return now[2:4]
    forward = now[2] * ca.cos(now[4]) + now[3] * ca.sin(now[4])
    if isinstance(dynamics, Unicycle):
        return ca.vertcat(forward, now[5])
    return ca.vertcat(forward, ca.atan(now[5] * dynamics.limits[2] / ca.fmax(forward, 0.1)))


def _move(ca: Any, dynamics: Dynamics, pose: Any, command: Any, dt: float) -> Any:
    """Return the position and heading after a step; an arc is taken as its chord."""
    if isinstance(dynamics, Holonomic):
        return ca.vertcat(pose[:2] + dt * command, pose[2])
    rate = command[1] if isinstance(dynamics, Unicycle) else command[0] * ca.tan(command[1]) / dynamics.limits[2]
    half = pose[2] + 0.5 * dt * rate
    way = dt * command[0]
    return ca.vertcat(pose[0] + way * ca.cos(half), pose[1] + way * ca.sin(half), pose[2] + dt * rate)


def _limits(ca: Any, dynamics: Dynamics, command: Any, before: Any, speed: Any, dt: float) -> list[Any]:
    """Return terms that are not negative if a command is within the limits, beside the bounds of its numbers."""
    change, most = command - before, dynamics.limits * dt
    if isinstance(dynamics, Holonomic):
        kept = [speed**2 - ca.sumsqr(command)]
        return kept + ([most[0] ** 2 - ca.sumsqr(change)] if math.isfinite(most[0]) else [])
    limited = [(0, most[0])] + ([(1, most[2])] if isinstance(dynamics, Unicycle) else [])
    return [limit - sign * change[k] for k, limit in limited if math.isfinite(limit) for sign in (1.0, -1.0)]


def _to_edge(ca: Any, x: Any, y: Any, edge: Any) -> Any:
    """Return the distance of a point from an edge."""
    ax, ay, bx, by = edge[0], edge[1], edge[2], edge[3]
    dx, dy = bx - ax, by - ay
    share = ca.fmin(ca.fmax(((x - ax) * dx + (y - ay) * dy) / (dx**2 + dy**2), 0.0), 1.0)
    return ca.sqrt((x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2 + 1e-6)


def import_casadi() -> Any:
    """Return the module. Raises InputError where it is not installed."""
    try:
        import casadi
    except ImportError:
        raise InputError("the planner mpc needs CasADi: pip install 'crowdbench[mpc]'") from None
    return casadi
