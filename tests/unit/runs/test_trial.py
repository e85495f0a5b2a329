import pytest

from crowdbench.catalog import load_scenario
from crowdbench.metrics.registry import METRICS
from crowdbench.runs.trial import trial_trace, try_plugins
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

POLICY = """
import numpy as np
from crowdbench import PedestrianPolicy

class Policy(PedestrianPolicy):
    def velocities(self, world, parameters):
        if world.step[0] == 9:
            raise RuntimeError("in a late step")
        return np.zeros((len(world), world.position.shape[1] - 1, 2))

policy = Policy
"""

LAYOUT = """
def layout(rng, radius, speed):
    raise RuntimeError("at the start")
"""


@pytest.fixture
def files(tmp_path):
    for name, text in (("mine", POLICY), ("layout", LAYOUT)):
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def test_the_trial_drives_the_first_case_with_a_standing_vehicle():
    trace = trial_trace(load_scenario("circle_crossing_5_visible"), Cases.parse("val:3:9"))
    assert (trace.split, trace.case.tolist()) == ("val", [3])
    assert (trace.position[0, : trace.steps[0], 0] == trace.position[0, 0, 0]).all()
    assert trace.undisturbed is not None  # for metrics that need it


def test_a_policy_that_fails_in_a_late_step_is_named_with_the_case(files):
    scenario = load_scenario("circle_crossing_5", pedestrians=str(files / "mine.py"))
    with pytest.raises(InputError, match=r"policy mine raised RuntimeError \(case 3, step 9\): in a late step"):
        try_plugins(scenario, Cases.parse("val:3:9"), METRICS)


def test_a_layout_that_fails_is_named_with_the_case(files):
    scenario = load_scenario("circle_crossing_5", {"layout": {"generator": str(files / "layout.py")}})
    with pytest.raises(InputError, match="case val/3, the layout raised RuntimeError: at the start"):
        try_plugins(scenario, Cases.parse("val:3:9"), METRICS)


def test_a_scenario_without_files_of_the_user_is_not_tried(monkeypatch):
    monkeypatch.setattr("crowdbench.runs.trial.trial_trace", None)
    try_plugins(load_scenario("circle_crossing_5"), Cases.parse("3"), METRICS)
