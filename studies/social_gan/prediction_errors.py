"""Errors of predictors: on the crowds of a scenario, and on recorded tracks.

ADE (average displacement error) at a horizon is the mean distance between predicted and true positions over the steps
up to the horizon, FDE (final displacement error) the distance at the horizon. A predictor of several modes has three
errors: that of its first mode, that of the mode which is best for all pedestrians of a world or window together, as in
Gupta et al. (2018), and that of the best mode of each pedestrian. The best mode is chosen for ADE and FDE apart, and at
each horizon.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import Cases, InputError, Observation, Prediction, Predictor, Scenario
from crowdbench.core import HISTORY, PERFECT_SENSOR, norm
from crowdbench.metrics import Estimate, bootstrap_distribution, interval, weighted_mean
from crowdbench.predict import validate_prediction
from crowdbench.scenario import CONTINUING_ARRIVALS, RecordedTracks
from crowdbench.sim import crowd_decisions, limit_velocities, observe, step_pedestrians
from crowdbench.utils import BATCH, is_integer, plugin_errors, require
from studies.social_gan.horizons import HORIZON, MOST_AHEAD
from studies.social_gan.recordings import scenes
from studies.social_gan.windows import windows

Counted = Bool[np.ndarray, "world pedestrian"]
Positions = Float[np.ndarray, "world time pedestrian 2"]
Displacements = Float[np.ndarray, "world pedestrian 3 2 time"]

MEAN = "mean over scenes"
"""The key of the means over all scenes in the result of `on_tracks`."""

TOGETHER = 1
"""Index in the result of `displacement` of the mode that is best for all pedestrians together."""


@dataclass(frozen=True)
class Curves:
    """Errors in metres at horizons of 1, 2, ... steps.

    Attributes:
        ade: Average displacement error at each horizon; its interval is over cases or over pedestrians.
        fde: Final displacement error.
    """

    ade: list[Estimate]
    fde: list[Estimate]


@dataclass(frozen=True)
class Errors:
    """The errors of a predictor. With one mode, all three are the same.

    Attributes:
        modes: The number of its modes.
        first: Errors of the first mode.
        together: Errors of the mode that is best for all pedestrians of a world or window together.
        each: Errors of the best mode of each pedestrian.
    """

    modes: int
    first: Curves
    together: Curves
    each: Curves

    def choices(self) -> dict[str, Curves]:
        """Return the errors that differ, by their names in tables."""
        if self.modes == 1:
            return {"best of 1": self.first}
        best = f"best of {self.modes}"
        return {"best of 1": self.first, f"{best} together": self.together, f"{best} each": self.each}


def on_scenario(
    name: str,
    predictor: Predictor,
    scenario: Scenario,
    cases: Cases,
    ahead: int = HORIZON,
    progress: Callable[[int], object] = lambda _: None,
) -> Errors:
    """Measure a predictor on the crowds of a scenario, without a vehicle, and so with perfect sight.

    It predicts at every step with `ahead` more steps before the time limit. A pedestrian counts if it exists during all
    of these steps, until its distance to its goal is below its radius: pedestrians that have arrived are easy to
    predict. Intervals come from resampled cases. For recorded pedestrians, they come from resampled blocks of time, and
    a trained predictor uses weights that were not trained on the scene.

    Args:
        name: Name of the predictor in errors.
        predictor: The predictor.
        scenario: The scenario of the cases.
        cases: The cases.
        ahead: The number of steps that are predicted.
        progress: Called with the number of cases that were finished.

    Raises:
        InputError: The predictor breaks its contract, no pedestrian walks for long enough, or `ahead` is not from 1 to
            `MOST_AHEAD`.
    """
    _check_ahead(ahead)
    cluster = np.arange(len(cases))
    if scenario.tracks:
        predictor = predictor.for_held_out_scene(scenario.tracks.scene)
        _, cluster = np.unique(scenario.tracks.blocks(cases.split, cases.indices), return_inverse=True)
    clusters = _Clusters.empty(int(cluster.max()) + 1, ahead)
    for part in cases.batches(BATCH):
        own = cluster[part.start - cases.start :]
        for prediction, walking, truth in _walks(name, predictor, scenario, part, ahead):
            row, _ = np.nonzero(walking)
            clusters.add(own[row], prediction, truth, walking)
        progress(len(part))
    if not clusters.count.any():
        raise InputError(
            f"{scenario.name} has nothing to predict in cases {cases}: no pedestrian is on its way "
            f"{ahead} steps before the time limit"
        )
    return _estimate_errors([clusters], clusters.modes)


def on_tracks(
    name: str,
    predictor: Predictor,
    recordings: Sequence[RecordedTracks],
    ahead: int = HORIZON,
    progress: Callable[[int], object] = lambda _: None,
) -> dict[str, Errors]:
    """Measure a predictor on recorded tracks.

    It is measured in all windows of 8 observed frames and `ahead` frames after them. A trained predictor uses
    weights for each scene that were not trained on it. Every pedestrian of every window of a scene has the same weight.
    Windows overlap, so intervals come from resampled pedestrians, each with all its windows.

    Args:
        name: Name of the predictor in errors.
        predictor: The predictor.
        recordings: The recorded tracks, of one scene or several.
        ahead: The number of frames that are predicted.
        progress: Called with the number of scenes that were finished.

    Returns:
        The errors by scene, and under `MEAN` their means over the scenes.

    Raises:
        InputError: The predictor breaks its contract or is privileged, a recording has no window, or `ahead` is not
            from 1 to `MOST_AHEAD`.
    """
    if predictor.privileged:
        raise InputError(
            f"predictor {name} is privileged, it asks the simulator: evaluate it on a scenario, not on recordings"
        )
    _check_ahead(ahead)
    by_scene = {}
    for scene, parts in scenes(recordings).items():
        unseen = predictor.for_held_out_scene(scene)
        by_scene[scene] = _Clusters.join([_of_recording(name, unseen, tracks, ahead) for tracks in parts])
        progress(1)
    if not by_scene:
        raise InputError("all of these recordings are those that ETH/UCY has for training only: give one to test on")
    modes = max(clusters.modes for clusters in by_scene.values())
    errors = {scene: _estimate_errors([clusters], modes) for scene, clusters in by_scene.items()}
    return errors | {MEAN: _estimate_errors(list(by_scene.values()), modes)}


def displacement(prediction: Prediction, truth: Positions, counted: Counted) -> Displacements:
    """Return ADE and FDE of each pedestrian at each horizon.

    Args:
        prediction: The prediction.
        truth: The true positions in metres.
        counted: Which pedestrians count when the best mode for all of them together is chosen.

    Returns:
        Errors in metres. Axis 2 is the mode: the first, the best for all together, the best for the pedestrian.
        Axis 3 is ADE, FDE.
    """
    distance = norm(prediction.position - truth[:, None])
    steps = np.arange(1, distance.shape[2] + 1)
    both = np.stack([distance.cumsum(axis=2) / steps[:, None], distance], axis=-1)
    total = np.where(counted[:, None, None, :, None], both, 0.0).sum(axis=3, keepdims=True)
    together = np.take_along_axis(both, total.argmin(axis=1, keepdims=True), axis=1)[:, 0]
    return np.stack([both[:, 0], together, both.min(axis=1)]).transpose(1, 3, 0, 4, 2)


def _check_ahead(ahead: int) -> None:
    is_possible = is_integer(ahead) and 1 <= ahead <= MOST_AHEAD
    require("ahead", ahead, is_possible, f"a whole number of steps from 1 to {MOST_AHEAD}")


def _walks(
    name: str, predictor: Predictor, scenario: Scenario, cases: Cases, ahead: int
) -> Iterator[tuple[Prediction, Counted, Positions]]:
    """Yield the prediction of each step, the pedestrians that have not arrived then, and their true positions."""
    world = scenario.worlds(cases)
    world = world.replace(rules=dataclasses.replace(world.rules, visible=False, sensor=PERFECT_SENSOR), sight={})
    arrived, goes_on = np.zeros_like(world.present[:, 1:]), scenario.crowd.arrival in CONTINUING_ARRIVALS
    predicted: deque[tuple[Prediction, Counted, Int[np.ndarray, "world pedestrian"]]] = deque()
    positions: deque[Float[np.ndarray, "world pedestrian 2"]] = deque(maxlen=ahead)
    for _ in range(scenario.rules.max_steps):
        at_goal = (norm(world.position - world.goal) < world.radius)[:, 1:]
        # An arrived pedestrian is on its way again if pedestrians then walk on to another goal.
        arrived = at_goal if goes_on else arrived | at_goal
        walking = world.present[:, 1:] & ~arrived
        crowd, world = crowd_decisions(world, scenario.policies)
        obs = observe(world, future=limit_velocities(world, crowd) if predictor.privileged else None)
        predicted.append((_predict(name, predictor, obs, ahead), walking, world.person))
        world = step_pedestrians(world, crowd, scenario.post_step_rule)
        positions.append(world.position[:, 1:])
        if len(positions) == ahead:
            prediction, counted, persons = predicted.popleft()
            if not (counted.any() or goes_on or scenario.tracks):
                return
            stayed = (persons == world.person) & world.present[:, 1:]
            yield prediction, counted & stayed, np.stack(positions, axis=1)


def _of_recording(name: str, predictor: Predictor, tracks: RecordedTracks, ahead: int) -> _Clusters:
    samples = windows(tracks, HISTORY + ahead)
    if not len(samples):
        raise InputError(
            f"the recording {tracks.name} has no window: it needs two pedestrians in the same "
            f"{HISTORY + ahead} consecutive frames"
        )
    ids, identity = np.unique(samples.pedestrian, return_inverse=True)
    clusters = _Clusters.empty(len(ids), ahead)
    for start in range(0, len(samples), BATCH):
        rows = slice(start, start + BATCH)
        part = samples.take(rows)
        prediction = _predict(name, predictor, part.observation(HISTORY), ahead)
        clusters.add(identity[rows][part.present], prediction, part.position[:, HISTORY:], part.present)
    return clusters


def _predict(name: str, predictor: Predictor, obs: Observation, ahead: int) -> Prediction:
    """Return the prediction of a predictor. Raises InputError if it fails, or returns no finite prediction."""
    with plugin_errors(f"predictor {name} raised"):
        answer = predictor.predict(obs, ahead)
    return validate_prediction(answer, name, obs, ahead)


@dataclass
class _Clusters:
    """Errors summed over each cluster of dependent samples: all of a case, or all of a pedestrian.

    Attributes:
        total: Sum of the errors in metres, as in `displacement`.
        count: The number of samples.
        modes: Largest number of modes of a prediction.
    """

    total: Float[np.ndarray, "cluster 3 2 time"]
    count: Float[np.ndarray, "cluster"]
    modes: int

    @classmethod
    def empty(cls, n: int, ahead: int) -> _Clusters:
        return cls(np.zeros((n, 3, 2, ahead)), np.zeros(n), modes=1)

    @classmethod
    def join(cls, parts: Sequence[_Clusters]) -> _Clusters:
        total, count = (np.concatenate([getattr(part, name) for part in parts]) for name in ("total", "count"))
        return cls(total, count, max(part.modes for part in parts))

    def add(
        self, cluster: Int[np.ndarray, "sample"], prediction: Prediction, truth: Positions, counted: Counted
    ) -> None:
        np.add.at(self.total, cluster, displacement(prediction, truth, counted)[counted])
        np.add.at(self.count, cluster, 1.0)
        self.modes = max(self.modes, prediction.position.shape[1])


def _estimate_errors(by_scene: Sequence[_Clusters], modes: int) -> Errors:
    """Return the mean over scenes, which have the same weight, of the means in each."""
    steps = range(by_scene[0].total.shape[3])
    curves = [
        Curves(*([_estimate(by_scene, choice, measure, step) for step in steps] for measure in (0, 1)))
        for choice in range(1 if modes == 1 else 3)
    ]
    return Errors(modes, curves[0], *(curves[1:] or curves * 2))


def _estimate(by_scene: Sequence[_Clusters], choice: int, measure: int, step: int) -> Estimate:
    of_scenes, resampled = [], []
    for number, clusters in enumerate(by_scene):
        seen = clusters.count > 0
        total, weights = clusters.total[seen, choice, measure, step], clusters.count[seen]
        values = total / weights
        of_scenes.append((float(total.sum() / weights.sum()), len(values), float(values.max())))
        # Shifted, because two scenes of the same size have the same resamples, which would make them dependent.
        resampled.append(np.roll(bootstrap_distribution(weighted_mean, values, weights), number))
    means, counts, largest = zip(*of_scenes, strict=True)
    return Estimate(sum(means) / len(means), *interval(np.mean(resampled, axis=0)), sum(counts), max(largest))
