"""Checks what a predictor keeps of its contract, on observations of real episodes."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError, plugin_errors
from crowdbench.evaluate.check.again import EXACT, Replay, Tolerance, same_point
from crowdbench.evaluate.check.padding import MORE, with_more_unseen
from crowdbench.evaluate.check.point import Findings, Point, changed, time_point
from crowdbench.evaluate.check.sight import UNEXAMINED, few, with_nan_hidden, with_people_hidden
from crowdbench.evaluate.check.trial import trial
from crowdbench.predict import Prediction, Predictor
from crowdbench.predict.checked import checked, finite, shaped
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation

EVERY = 3
"""It predicts at every third step, because neighbouring steps are alike."""

MOST_STEPS = 8
"""It predicts 1, 2, ... and so many steps, in turn."""

FEW, MANY = 2, 5
"""Numbers of modes, of which the first must be the same."""

Futures = Float[np.ndarray, "world mode time pedestrian 4"]
"""Positions in metres and velocities in m/s, 0 for pedestrians that are not seen, whose futures do not matter."""

MISSING = "not examined: the predictor returned no prediction"


def check_predictor(
    make: Callable[[], Predictor],
    name: str,
    scenario: Scenario,
    cases: Cases,
    limit: float,
    with_modes: Callable[[int], Predictor] | None = None,
    tolerance: Tolerance = EXACT,
    limited: Scenario | None = None,
) -> list[Point]:
    """Let a predictor predict the pedestrians of some cases and examine each point of its contract by itself.

    Args:
        make: Makes a new predictor.
        name: What the predictor is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.
        limit: Seconds that the predictor may take for all worlds together.
        with_modes: Makes a new predictor with a number of modes; None where it has no option `modes`.
        tolerance: What may depend on the batch.
        limited: A scenario in which the vehicle does not see everybody, if the predictor is to predict in some of its
            cases too.

    Raises:
        InputError: Something other than the predictor breaks its contract, or it cannot be made.
    """
    witness = _watched(make, name, scenario, cases)
    findings, again = witness.findings, _again(witness, make, tolerance)
    points = [
        findings.point("exceptions", "none"),
        time_point("time", witness.seconds, limit, MISSING),
        findings.point("type and shape", "floats [world, mode, time, pedestrian, 2]"),
        findings.point("finite", "all for those seen"),
        findings.point("observation", "unchanged"),
        again.deterministic(_asking(witness.predictor, name)),
        again.batch(),
        again.changed(
            "padding",
            {f"with {MORE} more pedestrians who are not seen": with_more_unseen},
            lambda futures: futures[:, :, :, :-MORE],
        ),
    ]
    if with_modes is not None:
        points.append(_modes(with_modes, name, [obs for obs, _ in witness.shown], tolerance))
    if limited is not None:
        sound = all(point.kept for point in points)
        points.append(_limited_sight(make, name, limited, few(cases), tolerance) if sound else UNEXAMINED)
    return points


class _Witness:
    """Keeps what a predictor is shown and answers.

    Attributes:
        predictor: The predictor.
        findings: What was found at each point.
        seconds: How long each call took.
        shown: The observation of each call, with the prediction.

    Args:
        predictor: The predictor.
        name: What it is called in errors.
    """

    def __init__(self, predictor: Predictor, name: str) -> None:
        self.predictor = predictor
        self.name = name
        self.findings = Findings("worlds", MISSING)
        self.seconds: list[float] = []
        self.shown: list[tuple[Observation, Futures]] = []

    def ask(self, obs: Observation) -> None:
        """Show the predictor an observation and keep what it answers."""
        before = obs.take(slice(None))
        prediction = self.findings.examine(
            len(obs),
            {
                "exceptions": lambda _: self._timed(obs),
                "type and shape": lambda answer: shaped(answer, self.name, before, _steps(before)),
                "finite": lambda shape: finite(shape, self.name, before),
            },
        )
        found = changed("obs", before, obs)
        self.findings.note("observation", len(obs), found and f"changes {found[0]} (step {before.step[0]})")
        if prediction is not None:
            self.shown.append((before, _seen(prediction, before)))

    def _timed(self, obs: Observation) -> object:
        start = time.perf_counter()
        answer = _asked(self.predictor, self.name, obs)
        self.seconds.append(time.perf_counter() - start)
        return answer


def _watched(make: Callable[[], Predictor], name: str, scenario: Scenario, cases: Cases) -> _Witness:
    """What a new predictor is shown and answers in some cases."""
    witness = _Witness(make(), name)
    _, observed = trial(scenario, cases, witness.predictor.privileged)
    for obs in observed[::EVERY]:
        witness.ask(obs)
    return witness


def _again(witness: _Witness, make: Callable[[], Predictor], tolerance: Tolerance) -> Replay[Observation]:
    """Shows new predictors what one was shown before. Arguments as in `check_predictor`."""
    ask = functools.partial(_asking, name=witness.name)
    return Replay("worlds' predictions", witness.shown, Observation.take, lambda: ask(make()), tolerance, MISSING)


def _limited_sight(
    make: Callable[[], Predictor], name: str, scenario: Scenario, cases: Cases, tolerance: Tolerance
) -> Point:
    """The point of predicting without seeing everybody. Arguments as in `check_predictor`."""
    witness = _watched(make, name, scenario, cases)
    for fault in witness.findings.faults.values():
        return Point("limited sight", False, f"where the vehicle does not see everybody: {fault}")
    hidden = {
        "with NaN in the rows of those who are not seen": with_nan_hidden,
        "with other people in these rows": with_people_hidden,
    }
    return _again(witness, make, tolerance).changed("limited sight", hidden)


def _steps(obs: Observation) -> int:
    """For how many steps it is asked."""
    return 1 + int(obs.step[0]) // EVERY % MOST_STEPS


def _asked(predictor: Predictor, name: str, obs: Observation) -> object:
    with plugin_errors(f"predictor {name} raised"):
        return predictor.predict(obs, _steps(obs))


def _asking(predictor: Predictor, name: str) -> Callable[[Observation], Futures]:
    """A predictor as a function that raises InputError where it breaks its contract."""
    return lambda obs: _seen(checked(_asked(predictor, name, obs), name, obs, _steps(obs)), obs)


def _seen(prediction: Prediction, obs: Observation) -> Futures:
    futures = np.concatenate([prediction.position, prediction.velocity], axis=4)
    return np.where(obs.pedestrians.seen[:, None, None, :, None], futures, 0.0)


def _modes(
    with_modes: Callable[[int], Predictor], name: str, shown: Sequence[Observation], tolerance: Tolerance
) -> Point:
    """Whether the first modes are the same where there are more of them."""

    def futures(modes: int) -> list[Futures]:
        ask = _asking(with_modes(modes), name)
        return [ask(obs.take(slice(None)))[:, :FEW] for obs in shown]

    if not shown:
        return Point("modes", None, MISSING)
    try:
        few = futures(FEW)
    except InputError as error:
        return Point("modes", False, f"with {FEW} modes: {error}")
    again = {f"in the first {FEW} of {MANY} modes": lambda: futures(MANY)}
    return same_point("modes", "worlds' predictions", few, again, tolerance)
