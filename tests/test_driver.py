"""A planner that breaks its contract is told so in one sentence."""

import threading
import time

import numpy as np
import pytest
from helpers import Still, drive

from crowdbench.errors import InputError
from crowdbench.planner import OneWorldPlanner, Planner


class Says(Planner):
    """Returns what it is given to return, from the third step on."""

    def __init__(self, answer):
        self.answer = answer

    def plan(self, obs):
        return self.answer(obs) if obs.step[0] >= 2 else np.zeros((len(obs), 2))


def nan_for_case_3(obs):
    command = np.zeros((len(obs), 2))
    command[obs.case == 3, 1] = np.nan
    return command


def fast_for_case_4(obs):
    command = np.zeros((len(obs), 2))
    command[obs.case == 4] = [1.0, 0.3]
    return command


def forever(obs):
    while True:
        try:
            time.sleep(0.001)
        except Exception:
            continue


BROKEN = {
    "not a number": (nan_for_case_3, "returned [0.0, nan], but a velocity must be finite (case 3, step 2)"),
    "one number per world": (lambda obs: np.zeros(len(obs)), "returned shape [5] instead of [5, 2]"),
    "a world too few": (lambda obs: np.zeros((len(obs) - 1, 2)), "returned shape [4, 2] instead of [5, 2]"),
    "a string": (lambda obs: "north", "returned a str instead of a float array"),
    "integers": (lambda obs: np.zeros((len(obs), 2), int), "returned a int64 array instead of a float array"),
    "too fast": (fast_for_case_4, "asked for 1.04403 m/s, but the vehicle's maximum is 1 m/s (case 4, step 2)"),
    "an exception": (lambda obs: 1 / 0, "raised ZeroDivisionError: division by zero (case 0, step 2)"),
    "peeking": (lambda obs: obs.true_next(), "raised PermissionError: true_next()"),
    "no end": (forever, "thought longer than the limit of 0.2 s (case 0, step 2)"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_planner_gets_one_sentence(name):
    answer, expected = BROKEN[name]
    with pytest.raises(InputError) as error:
        drive(Says(answer), "5", decision_limit=0.2)
    assert str(error.value).startswith("planner Says ")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_a_speed_within_rounding_is_no_offence():
    trace = drive(Says(lambda obs: np.tile([1.0 + 5e-7, 0.0], (len(obs), 1))), "3")
    assert (trace.velocity[:, 3, 0, 0] == 1.0 + 5e-7).all()


def test_single_precision_commands_are_taken():
    assert (drive(Says(lambda obs: np.zeros((len(obs), 2), np.float32)), "3").steps > 2).all()


def test_the_decision_limit_leaves_other_threads_alone():
    done = []
    thread = threading.Thread(target=lambda: done.append(drive(Still(), "2")))
    thread.start()
    thread.join()
    assert len(done) == 1


def test_a_planner_for_one_world_is_lifted_to_batches():
    seen = []

    def straight(obs):
        shapes = obs.vehicle.position.shape, obs.pedestrians.history.shape, obs.normal("x", 3).shape
        seen.append((*shapes, float(obs.time)))
        offset = obs.vehicle.goal - obs.vehicle.position
        obs.log("distance", np.linalg.norm(offset))
        return 0.99 * offset / np.linalg.norm(offset)

    class Straight(Planner):
        def plan(self, obs):
            offset = obs.vehicle.goal - obs.vehicle.position
            return 0.99 * offset / np.linalg.norm(offset, axis=1, keepdims=True)

    lifted, batched = drive(OneWorldPlanner(straight), "10"), drive(Straight(), "10")
    assert np.allclose(lifted.position, batched.position, equal_nan=True)
    assert set(seen[:10]) == {((2,), (8, 5, 2), (5, 3), 0.0)}
