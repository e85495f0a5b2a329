"""The shipped learned planners still decide what they did when they were recorded."""

import json
import os
import platform
import subprocess
import sys

import numpy as np
import pytest
import torch
from golden.record import FOLDER, PLANNERS, POLICY, SEQUENCES, losses, outcomes, states_of

from crowdbench import load_planner

TIE = 1e-5
"""Values that differ by less are a tie, which may fall either way: networks round by the shape of their batch."""

CHANGES = {
    "cadrl": [{"weights": "cadrl-seed1"}, {"predictor": "linear"}],
    "lstm_rl": [{"weights": "lstm_rl-seed0"}, {"predictor": "linear"}],
    "sarl": [{"predictor": "constant_velocity"}],
    "sarl_lin": [{"predictor": "constant_velocity"}],
    "sarl_cvm": [{"weights": "sarl-seed0"}, {"predictor": "linear"}],
    "sarl_sgan": [{"modes": 10}, {"modes": 5}, {"shortlist": 1}],
    "sarl_sgan_kce": [
        {"predictor": "sgan_simulated"},
        {"modes": 10},
        {"modes": 5},
        {"shortlist": 1},
        {"limits": False},
        {"limits": {"max_velocity_change": 1.0}},
        {"weights": "sarl"},
        {"shaping": False},
        {"explore": False},
        {"explore": {"n": 1}},
    ],
    "sarl_sgan_kce_bounded": [{"limits": {"max_velocity_change": 0.9}}, {"weights": "sarl_kce"}],
}
"""Options that change a planner in one part."""


@pytest.fixture(params=[1, pytest.param(2, marks=pytest.mark.slow)])
def threads(request):
    """So many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def golden(name):
    """What was recorded of a planner."""
    return json.loads((FOLDER / f"{name}.json").read_text())


def decides_as_recorded(name, **options):
    """Whether, to a planner, the commands recorded under that name are worth what its own are."""
    found = losses(load_planner(name, options)[1], states_of(name), np.array(golden(name)["commands"]))
    assert len(found) > 60
    return bool((found < TIE).all())


LONG = ("sarl_sgan_kce_bounded", SEQUENCES)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in (*PLANNERS, POLICY, SEQUENCES)]
)
def test_golden_cases_end_as_recorded(name, threads):
    assert outcomes(name) == golden(name)["outcomes"]


@pytest.mark.parametrize("name", PLANNERS)
def test_golden_commands_are_decided_as_recorded(name, threads):
    assert decides_as_recorded(name)


@pytest.mark.parametrize(("weights", "is_same"), [("ppo", True), ("ppo-seed1", False)])
def test_golden_commands_of_a_policy_are_as_recorded(weights, is_same, threads):
    commands = load_planner(POLICY, {"weights": weights})[1].plan(states_of(POLICY))
    assert np.allclose(commands, golden(POLICY)["commands"], rtol=0.0, atol=1e-5) == is_same


@pytest.mark.parametrize(("name", "options"), [(name, options) for name in PLANNERS for options in CHANGES[name]])
def test_golden_commands_notice_a_change_of_any_part(name, options):
    assert not decides_as_recorded(name, **options)


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="needs a processor of x86-64")
def test_episodes_have_the_same_bits_without_avx_and_fma():
    scenarios = ["circle_crossing_5", "car_12", "doorway_10", "office_8", "restless_20", "crowdnav_plus_20"]
    environment = os.environ | {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}
    done = subprocess.run([sys.executable, FOLDER / "episodes.py", *scenarios], env=environment)
    assert done.returncode == 0, "some episodes differ: their names are printed"
