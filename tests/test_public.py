import crowdbench

NAMES = [
    "METRICS",
    "Cases",
    "Driver",
    "InputError",
    "Observation",
    "OneWorldPlanner",
    "Outcome",
    "PedestrianPolicy",
    "Planner",
    "Rules",
    "Scenario",
    "Trace",
    "World",
    "flatten",
    "load_planner",
    "load_scenario",
    "parallel_env",
    "rollout",
]


def test_the_public_names_are_these():
    assert crowdbench.__all__ == NAMES
    assert dir(crowdbench) == sorted(NAMES)


def test_every_public_name_is_there_and_documented():
    for name in NAMES:
        assert getattr(crowdbench, name).__doc__, name
