import pytest

from crowdbench.catalog import load_scenario
from crowdbench.envs.rewards import load_reward
from crowdbench.metrics.registry import METRICS
from crowdbench.runs.trial import trial_trace, try_plugins, try_reward
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


LATE_LAYOUT = """
import numpy as np
from crowdbench.scenario.placement import Placement

calls = []

def layout(rng, radius, speed):
    calls.append(1)
    if len(calls) > 1:
        raise RuntimeError("in a respawn")
    start = np.stack([3.0 * np.arange(len(radius)), np.zeros(len(radius))], axis=1)
    return Placement(start, start + [0.0, 3.0])
"""


def test_a_layout_that_fails_in_a_respawn_is_named_with_case_and_step(tmp_path):
    (tmp_path / "mine.py").write_text(LATE_LAYOUT)
    overrides = {"layout": {"generator": str(tmp_path / "mine.py")}, "pedestrians.arrival": "respawn"}
    with pytest.raises(InputError, match=r"^case 3, step \d+: the layout raised RuntimeError: in a respawn"):
        try_plugins(load_scenario("circle_crossing_5", overrides), Cases.parse("val:3:9"), METRICS)


def test_a_reward_that_fails_in_a_late_step_is_named_with_case_and_step(tmp_path):
    (tmp_path / "mine.py").write_text(
        "def reward(step):\n    if step.ended.any(): raise RuntimeError('at the end')\n    return step.gap * 0.0"
    )
    reward = load_reward(str(tmp_path / "mine.py"))
    with pytest.raises(InputError, match=r"reward mine raised RuntimeError \(case 0, step \d+\): at the end"):
        try_reward(reward, load_scenario("circle_crossing_5"))
