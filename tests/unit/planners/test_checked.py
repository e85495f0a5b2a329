"""What a predictor may return, wherever it is asked."""

import dataclasses

import numpy as np
import pytest

from crowdbench import Cases, InputError, load_network, load_scenario
from crowdbench.networks.value import NETWORKS
from crowdbench.planners.driver import Driver
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict.linear import ConstantVelocity
from crowdbench.predict.predictor import Prediction, Predictor, validate_prediction
from crowdbench.runs.rollout import rollout
from crowdbench.sim.sensor import observe
from studies.social_gan.horizons import MOST_AHEAD
from studies.social_gan.prediction_errors import on_scenario


class Mine(Predictor):
    """Constant velocity, and what `change` makes of it."""

    def __init__(self, change):
        self.change = change

    def predict(self, obs, steps):
        return self.change(ConstantVelocity().predict(obs, steps))


def with_nan(prediction):
    """A prediction with NaN at one place of its velocities."""
    prediction.velocity[1, 0, 0, 2] = np.nan
    return prediction


class Hiding(np.ndarray):
    """An array that says of itself what it likes."""

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return np.bool_(True) if ufunc is np.isfinite else NotImplemented


def hiding(prediction):
    """A prediction in arrays of a class of its own, full of NaN."""
    return Prediction((prediction.position * np.nan).view(Hiding), prediction.velocity)


WRONG = [
    (with_nan, r"velocities that are not finite: \[nan, nan\] for pedestrian 2 1 steps ahead in mode 0 .row 1 of"),
    (hiding, "positions that are not finite"),
    (lambda right: dataclasses.replace(right, position=right.position * np.inf), "positions that are not finite"),
    (lambda right: Prediction(right.position[0], right.velocity), "positions of shape"),
    (lambda right: Prediction(right.position, right.velocity[:, :, :, :2]), "velocities of shape"),
    (lambda right: Prediction(right.position, right.velocity.repeat(2, axis=1)), "in 1 modes and velocities in 2"),
    (lambda right: Prediction(right.position.astype(int), right.velocity), "positions that are not an array of floats"),
    (lambda right: right.position, "a ndarray instead of a Prediction"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_a_wrong_prediction_is_named_in_a_run(change, message, monkeypatch):
    monkeypatch.setattr(Prediction, "__init__", plain)
    planner = ValuePlanner(Mine(change), load_network("cadrl", "cadrl"))
    with pytest.raises(InputError, match=f"predictor Mine returned .*{message}"):
        rollout(Driver(planner, "mine"), load_scenario("circle_crossing_5"), Cases("val", 0, 3))


def plain(self, position, velocity):
    """The constructor of `Prediction` without the checks of the tests."""
    object.__setattr__(self, "position", position)
    object.__setattr__(self, "velocity", velocity)


def test_what_is_predicted_for_the_absent_does_no_harm():
    obs = observe(load_scenario("circle_crossing_5").draw("val", np.arange(2)))
    obs.pedestrians.seen[0, 1] = False
    right = ConstantVelocity().predict(obs, 3)
    wrong = Prediction(right.position.copy(), right.velocity)
    wrong.position[0, :, :, 1] = np.nan
    found = validate_prediction(wrong, "mine", obs, 3)
    assert np.isfinite(found.position).all()
    assert np.array_equal(found.position[1], right.position[1])


def test_a_network_that_gives_nan_is_named():
    network = NETWORKS["cadrl"]()
    for weights in network.parameters():
        weights.data *= np.nan
    planner = ValuePlanner(ConstantVelocity(), network)
    with pytest.raises(InputError, match="the value network cadrl gave a value of nan, but values must be finite"):
        planner.plan(observe(load_scenario("circle_crossing_5").draw("val", np.arange(2))))


@pytest.mark.parametrize("ahead", [0, MOST_AHEAD + 1, 10**20, True])
def test_a_number_of_steps_that_cannot_be_predicted_is_refused(ahead):
    with pytest.raises(InputError, match=f"ahead is {ahead}, but must be a whole number of steps from 1 to"):
        on_scenario("cvm", ConstantVelocity(), load_scenario("circle_crossing_5"), Cases("val", 0, 3), ahead)
