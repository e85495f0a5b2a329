"""Shipped planners drive, and metrics are, as they were recorded for this version of the simulator."""

import json
import os
import platform
import subprocess
import sys

import numpy as np
import pytest
import torch
from golden import episodes
from golden.record import FOLDER, PLANNERS, POLICY, SEQUENCES, losses, outcomes, states_of

from crowdbench import load_planner, load_scenario
from crowdbench.catalog import PLANNERS as SHIPPED
from crowdbench.sim import SIMULATOR

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
    found = losses(load_planner(name, options), states_of(name), np.array(golden(name)["commands"]))
    assert len(found) > 60
    return bool((found < TIE).all())


QUICK = ("cadrl", "sarl_sgan", POLICY)
"""Planners that are driven by every run of the tests; with those whose names begin alike they share the code."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in (*PLANNERS, POLICY, SEQUENCES)],
)
def test_golden_cases_end_as_recorded(name, threads):
    assert outcomes(name) == golden(name)["outcomes"]


@pytest.mark.parametrize("name", PLANNERS)
def test_golden_commands_are_decided_as_recorded(name, threads):
    assert decides_as_recorded(name)


@pytest.mark.parametrize(("weights", "is_same"), [("ppo", True), ("ppo-seed1", False)])
def test_golden_commands_of_a_policy_are_as_recorded(weights, is_same, threads):
    commands = load_planner(POLICY, {"weights": weights}).plan(states_of(POLICY))
    assert np.allclose(commands, golden(POLICY)["commands"], rtol=0.0, atol=1e-5) == is_same


@pytest.mark.parametrize(
    ("name", "options"),
    [
        pytest.param(name, options, marks=[pytest.mark.slow] * name.startswith("sarl_sgan_kce"))
        for name in PLANNERS
        for options in CHANGES[name]
    ],
)
def test_golden_commands_notice_a_change_of_any_part(name, options):
    assert not decides_as_recorded(name, **options)


RECORDED = json.loads(episodes.FILE.read_text())
DRIVEN_LONG = episodes.SLOW | {"hybrid", "mppi", "cadrl", "lstm_rl", "sarl", "sarl_lin", "brne"}


@pytest.mark.parametrize(
    "planner",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in DRIVEN_LONG)) for name in episodes.shipped()],
)
def test_every_shipped_planner_drives_as_recorded(planner):
    found = {"simulator": SIMULATOR, "scenarios": {}, "episodes": {}, "metrics": {}}
    for name in episodes.OF_EVERY_PLANNER:
        scenario = load_scenario(name)
        found["scenarios"][name] = scenario.digest
        if episodes.drives_in(planner, name):
            cases = episodes.cases_of(planner, scenario)
            found["episodes"][f"{name} {cases} {planner}"] = episodes.episode(planner, scenario, cases)
    assert episodes.differences(RECORDED, found) == []


@pytest.mark.parametrize("name", ["circle_crossing_5_visible", "door_10"])
def test_metrics_are_as_recorded(name):
    scenario = load_scenario(name)
    tables = episodes.measure_metrics(scenario)
    found = {"simulator": SIMULATOR, "scenarios": {name: scenario.digest}, "episodes": {}, "metrics": tables}
    assert episodes.differences(RECORDED, found) == []


def test_episodes_of_all_shipped_planners_are_recorded():
    assert {key.split()[-1] for key in RECORDED["episodes"]} == set(SHIPPED.built_in())


def moved_position(found):
    found["episodes"]["a test:0:1 cadrl"]["after"][0][1] += 0.001


def moved_metric(found):
    found["metrics"]["a orca"]["success_rate"][1] += 1e-6


def moved_trace(found):
    found["episodes"]["a test:0:1 orca"] = "00"


def other_scenario(found):
    found["scenarios"]["a"] = "another"
    moved_trace(found)


def other_simulator(found):
    found["simulator"] += 1
    moved_trace(found)


CHANGED = {
    moved_position: f"a test:0:1 cadrl {episodes.MOVED}",
    moved_metric: f"a orca {episodes.MOVED}",
    moved_trace: f"a test:0:1 orca {episodes.MOVED}",
    other_scenario: "a is a new or another scenario: record anew",
    other_simulator: "all is recorded for version 1 of the simulator: record anew",
}


@pytest.mark.parametrize("change", CHANGED, ids=lambda change: change.__name__)
def test_what_moves_while_its_scenario_is_the_same_asks_for_another_version_of_the_simulator(change):
    outcome = {"outcomes": ["success"], "after": [[1.0, 2.0]]}
    recorded = {
        "simulator": 1,
        "scenarios": {"a": "digest"},
        "episodes": {"a test:0:1 orca": "ff", "a test:0:1 cadrl": outcome},
        "metrics": {"a orca": {"success_rate": [None, 1.0]}},
    }
    found = json.loads(json.dumps(recorded))
    assert episodes.differences(recorded, found) == []
    change(found)
    assert episodes.differences(recorded, found) == [CHANGED[change]]


def test_only_planners_that_are_named_may_drive_otherwise():
    assert episodes.is_planner_s(f"a test:0:1 orca {episodes.MOVED}", ["mppi", "orca"])
    assert not episodes.is_planner_s(f"a test:0:1 orca_margin {episodes.MOVED}", ["orca"])
    assert not episodes.is_planner_s("a is a new or another scenario: record anew", ["anew"])


@pytest.mark.nightly
@pytest.mark.skipif(platform.machine() != "x86_64", reason="needs a processor of x86-64")
def test_episodes_have_the_same_bits_without_avx_and_fma():
    scenarios = ["circle_crossing_5", "car_28", "door_10", "office_8", "mixed_20", "crowdnav_plus_20"]
    environment = os.environ | {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}
    done = subprocess.run([sys.executable, FOLDER / "episodes.py", *scenarios], env=environment)
    assert done.returncode == 0, "some episodes differ: their names are printed"
