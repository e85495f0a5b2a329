"""Checks what a predictor keeps of its contract, on observations of real episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.check.examination import EXACT, Examination, Tolerance, compare_answers
from crowdbench.check.inputs import (
    MORE,
    drive_trial,
    first_cases,
    with_more_unseen,
    with_nan_hidden,
    with_people_hidden,
)
from crowdbench.check.result import UNEXAMINED_SIGHT, CheckResult
from crowdbench.core.types import Observation
from crowdbench.predict import Prediction, Predictor
from crowdbench.predict.base import validate_numbers, validate_shape
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError, plugin_errors

EVERY = 3
"""It predicts at every third step, because neighbouring steps are alike."""

MOST_STEPS = 8
"""It predicts 1, 2, ... and so many steps, in turn."""

FEW, MANY = 2, 5
"""Numbers of modes, of which the first must be the same."""

Futures = Float[np.ndarray, "world mode time pedestrian 4"]
"""Positions in metres and velocities in m/s, 0 for pedestrians that are not seen, whose futures do not matter."""


def check_predictor(
    make: Callable[[], Predictor],
    name: str,
    scenario: Scenario,
    cases: Cases,
    limit: float,
    with_modes: Callable[[int], Predictor] | None = None,
    tolerance: Tolerance = EXACT,
    limited: Scenario | None = None,
) -> list[CheckResult]:
    """Let a predictor predict the pedestrians of some cases and examine each part of its contract by itself.

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
    examination = _PredictorExamination(make, name, tolerance)
    examination.ask_in(scenario, cases)
    findings = examination.findings
    results = [
        findings.result("exceptions", "none"),
        examination.time_result(limit),
        findings.result("type and shape", "floats [world, mode, time, pedestrian, 2]"),
        findings.result("finite", "all for those seen"),
        findings.result("observation", "unchanged"),
        examination.check_deterministic(),
        examination.check_batch(),
        examination.check_unaffected(
            "padding",
            {f"with {MORE} more pedestrians who are not seen": with_more_unseen},
            lambda futures: futures[:, :, :, :-MORE],
        ),
    ]
    if with_modes is not None:
        results.append(_check_modes(examination, with_modes))
    if limited is not None and all(result.kept for result in results):
        again = _PredictorExamination(make, name, tolerance)
        results.append(_check_limited_sight(again, limited, first_cases(cases)))
    elif limited is not None:
        results.append(UNEXAMINED_SIGHT)
    return results


class _PredictorExamination(Examination[Predictor, Observation]):
    answers = "worlds' predictions"
    missing = "not examined: the predictor returned no prediction"
    batch_names = "obs", "observation"

    def ask_in(self, scenario: Scenario, cases: Cases) -> None:
        """Let the predictor predict in some cases."""
        _, observed = drive_trial(scenario, cases, self.plugin.privileged)
        for obs in observed[::EVERY]:
            self.ask(obs)

    def query(self, plugin: Predictor, batch: Observation) -> object:
        with plugin_errors(f"predictor {self.name} raised"):
            return plugin.predict(batch, _steps(batch))

    def validators(self, batch: Observation) -> dict[str, Callable[[Any], Any]]:
        return {
            "type and shape": lambda answer: validate_shape(answer, self.name, batch, _steps(batch)),
            "finite": lambda prediction: validate_numbers(prediction, self.name, batch),
        }

    def numbers(self, plugin: Predictor, answer: Prediction, batch: Observation) -> Futures:
        futures = np.concatenate([answer.position, answer.velocity], axis=4)
        return np.where(batch.pedestrians.seen[:, None, None, :, None], futures, 0.0)

    def locate(self, batch: Observation, row: int) -> str:
        return f"step {batch.step[0]}"


def _steps(obs: Observation) -> int:
    """For how many steps it is asked."""
    return 1 + int(obs.step[0]) // EVERY % MOST_STEPS


def _check_modes(examination: _PredictorExamination, with_modes: Callable[[int], Predictor]) -> CheckResult:
    """Whether the first modes are the same where there are more of them."""

    def predict(modes: int) -> list[Futures]:
        predictor = with_modes(modes)
        batch = (obs.take(slice(None)) for obs, _ in examination.calls)
        return [examination.answer_numbers(predictor, obs)[:, :FEW] for obs in batch]

    try:
        few = predict(FEW)
    except InputError as error:
        return CheckResult("modes", False, f"with {FEW} modes: {error}")
    again = {f"in the first {FEW} of {MANY} modes": lambda: predict(MANY)}
    return compare_answers("modes", examination.answers, examination.missing, few, again, examination.tolerance)


def _check_limited_sight(examination: _PredictorExamination, scenario: Scenario, cases: Cases) -> CheckResult:
    """Whether it predicts without seeing everybody, and whether those who are not seen do not matter."""
    examination.ask_in(scenario, cases)
    for fault in examination.findings.faults.values():
        return CheckResult("limited sight", False, f"where the vehicle does not see everybody: {fault}")
    hidden = {
        "with NaN in the rows of those who are not seen": with_nan_hidden,
        "with other people in these rows": with_people_hidden,
    }
    return examination.check_unaffected("limited sight", hidden)
