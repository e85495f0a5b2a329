"""`crowdbench check` on policies, predictors and metrics: each fault is found."""

import functools
import time

import numpy as np
import pytest
from checks import CASES, PLACE, broken, policy_faults, results_of

from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import METRIC, PREDICTOR, _function_procedure, _sample_traces
from crowdbench.check.kinds import limited_sight
from crowdbench.metrics.registry import METRICS
from crowdbench.metrics.user_metrics import measure
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Oracle
from crowdbench.predict.predictor import Prediction, Predictor
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import PedestrianPolicy

LIMITED = load_scenario("circle_crossing_mixed", {"time_limit": 3.5, **limited_sight(0.25)})
KEYS = PLACE.worlds(CASES).noise_key.tolist()
"""By these a plug-in here knows its cases."""


class Walk(PedestrianPolicy):
    """Walks to the goal, unless `change` makes something else of the velocities in a step."""

    def __init__(self, change=lambda velocity, world: velocity):
        self.change = change

    def velocities(self, world, parameters):
        velocity = world.goal[:, 1:] - world.position[:, 1:]
        return self.change(velocity, world) if world.step[0] == 2 else velocity


class Late:
    """Takes long, once."""

    seconds = 0.1

    def __call__(self, answer, *shown):
        time.sleep(self.seconds)
        self.seconds = 0.0
        return answer


def push(velocity, world):
    world.position[0, 1] += 1e-9
    return velocity


def fill_memory(velocity, world):
    world.memory["orca"]["heading"] = velocity
    return velocity


def with_nan(velocity, world):
    velocity[world.noise_key == KEYS[1], 0] = np.nan
    return velocity


def slower_alone(velocity, world):
    return velocity * (0.5 if len(world) == 1 else 1.0)


def slower_in_wide_arrays(velocity, world):
    return velocity * (0.5 if velocity.shape[1] > 10 else 1.0)


POLICIES = {
    "an exception": (lambda velocity, world: 1 / 0, "answers", "pedestrian policy orca raised ZeroDivisionError"),
    "late": (Late(), "answers", "took longer than the limit of 0.05 s (case 0, step 2"),
    "a list": (lambda velocity, world: velocity.tolist(), "answers", "must return float64"),
    "one number": (lambda velocity, world: velocity[..., :1], "answers", "must return float64 of shape"),
    "single precision": (lambda velocity, world: velocity.astype(np.float32), "answers", "returned float32"),
    "not a number": (with_nan, "answers", "for pedestrian 0 of case 1, but a velocity must be finite"),
    "meddling": (push, "answers", "changes world.position (case 0, step 2"),
    "an array put into memory": (fill_memory, "answers", "changes world.memory['orca']['heading'] (case 0, step 2"),
    "herd": (slower_alone, "independent", "worlds' velocities differ when a case is driven alone"),
    "padding": (slower_in_wide_arrays, "independent", "worlds' velocities differ with 3 more absent pedestrians"),
}


@pytest.mark.parametrize("name", POLICIES)
def test_a_fault_of_a_policy_is_found(name):
    change, check, expected = POLICIES[name]
    faults = policy_faults(lambda: Walk(change), limit=0.05 if name == "late" else 60.0)
    assert set(faults) == {check}
    assert expected in faults[check]


class Smooth(Walk):
    """Keeps the velocities of the call before: in whatever batch that was."""

    before = None

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        if self.before is not None and self.before.shape == velocity.shape:
            velocity = 0.5 * (velocity + self.before)
        self.before = velocity
        return velocity


class SmoothByCase(Walk):
    """Keeps the velocities of the call before by case, and forgets them when an episode starts."""

    def __init__(self):
        super().__init__()
        self.before = {}

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        for row, (case, step) in enumerate(zip(world.case.tolist(), world.step.tolist(), strict=True)):
            if step > 0 and case in self.before:
                velocity[row] = 0.5 * (velocity[row] + self.before[case])
            self.before[case] = velocity[row].copy()
        return velocity


class Dice(Walk):
    """Draws random numbers of its own."""

    def velocities(self, world, parameters):
        return super().velocities(world, parameters) * np.random.default_rng().uniform(0.9, 1.0)


def test_a_policy_with_a_state_or_dice_of_its_own_is_found():
    assert "differ when repeated, first in case" in policy_faults(Smooth)["repeatable"]
    assert "repeatable" in policy_faults(SmoothByCase)
    assert set(policy_faults(Dice)) == {"repeatable", "independent"}


def test_good_policies_pass():
    for make in (Walk, lambda: PEDESTRIANS.load("orca")[1]):
        assert not policy_faults(make)


class Absent(Walk):
    """Returns what it likes for pedestrians that are not there."""

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        return np.where(world.present[:, 1:, None], velocity, len(world) * np.nan)


def test_what_a_policy_returns_for_the_absent_does_not_matter():
    assert not policy_faults(Absent)


def test_only_networks_may_be_rounded_by_the_batch():
    def rounded(velocity, world):
        return velocity * (1.0 + 1e-9 * len(world))

    assert set(policy_faults(lambda: Walk(rounded))) == {"independent"}
    assert not policy_faults(lambda: Walk(rounded), neural=True)


class Guess(Predictor):
    """Constant velocity, and what `change` makes of it at step 3."""

    def __init__(self, change=lambda prediction, obs: prediction):
        self.change = change

    def predict(self, obs, steps):
        prediction = ConstantVelocity().predict(obs, steps)
        return self.change(prediction, obs) if obs.step[0] == 3 else prediction


def predictor_faults(make, limited=False):
    scenarios = {"": PLACE} | ({"with limited sight: ": LIMITED} if limited else {})
    return broken(results_of(Subject(PREDICTOR, make, "mine", scenarios, neural=False)))


def infinite(prediction, obs):
    prediction.velocity[0, :, :, 0] = np.inf
    return prediction


def scaled(prediction, factor):
    return Prediction(prediction.position * factor, prediction.velocity * factor)


PREDICTORS = {
    "an exception": (lambda prediction, obs: [][1], "answers", "predictor mine raised IndexError"),
    "an array": (lambda prediction, obs: prediction.position, "answers", "a ndarray instead of a Prediction"),
    "infinite": (infinite, "answers", "returned velocities that are not finite"),
    "padding": (
        lambda prediction, obs: scaled(prediction, 1.0 + 0.1 * (obs.pedestrians.seen.shape[1] > 10)),
        "independent",
        "worlds' predictions differ with 3 more absent pedestrians",
    ),
}


@pytest.mark.parametrize("name", PREDICTORS)
def test_a_fault_of_a_predictor_is_found(name):
    change, check, expected = PREDICTORS[name]
    faults = predictor_faults(lambda: Guess(change))
    assert set(faults) == {check}
    assert expected in faults[check]


def test_good_predictors_pass():
    for make in (Oracle, ConstantVelocity, ConstantVelocitySampled):
        assert not predictor_faults(make, limited=True)


def velocities_of_the_hidden(crowd):
    return np.where(crowd.seen[:, :, None], 0.0, crowd.velocity)


# By what is added to all predictions: nothing with perfect sight, where the rows that are not seen are at rest.
PEEPS = {
    "hidden velocities": (
        lambda crowd: velocities_of_the_hidden(crowd).sum(axis=1),
        "and NaN in the rows of unseen pedestrians: predictor mine returned positions that are not finite",
    ),
    "a number where there is none": (
        lambda crowd: np.isnan(velocities_of_the_hidden(crowd)).any(axis=1).astype(float),
        "worlds' predictions differ with 3 more absent pedestrians, and NaN in the rows of unseen pedestrians",
    ),
    "an exception where nobody is seen": (
        lambda crowd: 0.0 * np.stack([row[mask][0] for row, mask in zip(crowd.position, crowd.seen, strict=True)]),
        "with limited sight: predictor mine raised IndexError",
    ),
}


@pytest.mark.parametrize("name", PEEPS)
def test_a_predictor_that_depends_on_the_hidden_is_found(name):
    peep, expected = PEEPS[name]

    class Peeps(Predictor):
        def predict(self, obs, steps):
            prediction = ConstantVelocity().predict(obs, steps)
            return Prediction(prediction.position + peep(obs.pedestrians)[:, None, None, None], prediction.velocity)

    faults = predictor_faults(Peeps, limited=True)
    assert set(faults) == {"answers" if "exception" in name else "independent"}
    assert expected in "".join(faults.values())


def metric_faults(metric, cases=CASES, procedure=METRIC):
    return broken(results_of(Subject(procedure, lambda: metric, "mine", {"": PLACE}, neural=False), cases))


def speed(trace):
    """Mean speed of the vehicle [m/s]."""
    return np.nanmean(np.linalg.norm(trace.command, axis=2), axis=1)


def above_the_others(trace):
    return speed(trace) > speed(trace).mean()


CALLS = []


def counted(trace):
    CALLS.append(len(trace))
    return np.full(len(trace), float(CALLS.count(len(CASES)) if len(trace) == len(CASES) else 1.0))


METRICS_THAT_OFFEND = {
    "an exception": (lambda trace: trace.nothing, "answers", "metric mine raised AttributeError"),
    "needs what is not there": (lambda trace: trace.undisturbed[:, 0, 0, 0], "answers", "raised TypeError"),
    "a number": (lambda trace: 1.0, "answers", "returned float, but must return one number or boolean per episode"),
    "per step": (lambda trace: trace.gap, "answers", "but must return one number or boolean per episode"),
    "infinite": (lambda trace: speed(trace) / 0.0, "answers", "is inf in case 0"),
    "a rank": (above_the_others, "independent", "values differ when a case is driven alone"),
}


@pytest.mark.parametrize("name", METRICS_THAT_OFFEND)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_a_fault_of_a_metric_is_found(name):
    metric, check, expected = METRICS_THAT_OFFEND[name]
    faults = metric_faults(metric)
    assert set(faults) == {check}
    assert expected in faults[check]


def test_a_metric_with_a_state_or_dice_of_its_own_is_found():
    assert "repeatable" in metric_faults(counted)
    assert set(metric_faults(lambda trace: np.random.default_rng().random(len(trace)))) == {"repeatable", "independent"}


@functools.cache
def traces(cases):
    return list(_sample_traces(PLACE, cases))


def test_all_metrics_of_crowdbench_pass():
    procedure = _function_procedure(lambda place, cases: traces(cases), measure, "values")
    for metric in (speed, *METRICS.values()):
        assert not metric_faults(metric, Cases.parse("val:2"), procedure)
