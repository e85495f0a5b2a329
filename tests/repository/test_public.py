import subprocess
import sys

import crowdbench

NAMES = [
    "METRICS",
    "MPPIPlanner",
    "ORCA",
    "Cases",
    "Driver",
    "Encoder",
    "Episodes",
    "InputError",
    "Observation",
    "OneWorldPlanner",
    "Outcome",
    "PedestrianPolicy",
    "Planner",
    "PolicyPlanner",
    "PolicyWithMemory",
    "Prediction",
    "Predictor",
    "Result",
    "Rules",
    "Scenario",
    "Trace",
    "ValuePlanner",
    "World",
    "along_route",
    "along_walls",
    "distance_to_walls",
    "export_policy",
    "flatten",
    "load_network",
    "load_planner",
    "load_predictor",
    "load_scenario",
    "parallel_env",
    "roll_out",
    "rollout",
    "run",
]


def test_the_public_names_are_these():
    assert crowdbench.__all__ == sorted(NAMES)
    assert dir(crowdbench) == sorted(NAMES)


def test_every_public_name_is_there_and_documented():
    for name in NAMES:
        assert getattr(crowdbench, name).__doc__, name


def test_the_public_functions_are_functions_whatever_was_imported_before():
    code = (
        "import inspect, crowdbench.cli, crowdbench.runs.run, crowdbench.check\n"
        "from crowdbench import flatten, load_planner, load_scenario, parallel_env, rollout\n"
        "print(all(map(inspect.isfunction, (flatten, load_planner, load_scenario, parallel_env, rollout))))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "True\n"
