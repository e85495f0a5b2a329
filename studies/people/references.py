"""Reference rows of the table: rollouts of no pedestrian policy. See definition.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crowdbench.scenario import ETH_UCY_DT
from studies.people.encounters import Places
from studies.people.simulate import ROLLOUTS
from studies.people.windows import Window

NOISE = 0.05
"""Standard deviation in metres of the noise on each coordinate of recorded positions."""

FASTEST = 2.0
"""Largest speed in m/s of random walkers."""


def recording_with_noise(window: Window) -> Places:
    """Return the recording with independent Gaussian noise in each frame after a person's first one."""
    noise = NOISE * window.stream("noise").standard_normal((ROLLOUTS, *window.future.shape))
    return window.future + np.where(_age(window)[..., None] > 0, noise, 0.0)


def random_walkers(window: Window) -> Places:
    """Return persons that walk at constant velocities, which are uniform in a disc of radius `FASTEST`."""
    share, turn = window.stream("random").random((2, ROLLOUTS, len(window.group)))
    speed, angle = FASTEST * np.sqrt(share), 2.0 * np.pi * turn
    velocity = speed[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    path = velocity[:, None] * ETH_UCY_DT * np.maximum(_age(window), 0)[..., None]
    return np.where(window.present[..., None], window.first + path, np.nan)


def resampled_motion(window: Window, donors: Sequence[Window]) -> Places:
    """Return persons that move like recorded persons of other locations with a similar speed in the history.

    Each rollout has another one of the `ROLLOUTS` donors with the nearest speeds. Its path is rotated into the heading
    of the person, and begins at the person's first position. Nobody sees others or a goal.

    Args:
        window: The window.
        donors: Windows of other locations. Donors are their scored persons that are present to the end.
    """
    speed, paths = _straightened(donors)
    stream = window.stream("resample")
    places = np.full((ROLLOUTS, *window.future.shape), np.nan)
    for person, (age, ahead) in enumerate(zip(_age(window).T, window.heading, strict=True)):
        nearest = np.argsort(np.abs(speed - window.speed[person]), kind="stable")[:ROLLOUTS]
        path = paths[stream.permutation(nearest)] @ np.array([ahead, [-ahead[1], ahead[0]]])
        here = window.present[:, person]
        places[:, here, person] = window.first[person] + path[:, age[here]]
    return places


def _straightened(donors: Sequence[Window]) -> tuple[np.ndarray, np.ndarray]:
    """Return the speed in the history of each donor in m/s, and its path `[donor, time, 2]` in metres, along and to the
    left of its heading."""
    speeds, paths = [], []
    for window in donors:
        whole = window.scored & window.present.all(axis=0)
        path = (window.future - window.future[0])[:, whole].swapaxes(0, 1)
        ahead = window.heading[whole][:, None]
        left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
        paths.append(np.stack([(path * ahead).sum(axis=-1), (path * left).sum(axis=-1)], axis=-1))
        speeds.append(window.speed[whole])
    return np.concatenate(speeds), np.concatenate(paths)


def _age(window: Window) -> np.ndarray:
    """Return the frames since each person's first one `[time, person]`, negative before it."""
    return np.arange(len(window.future))[:, None] - window.present.argmax(axis=0)
