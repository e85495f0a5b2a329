"""The study in which vehicle and pedestrians are one learner: its crowd, its vehicles, its training and its page."""

import sys
from pathlib import Path

import numpy as np
import pytest

from crowdbench import load_planner, load_scenario, parallel_env
from crowdbench.catalog import PEDESTRIANS
from crowdbench.cli.app import main
from crowdbench.sim.simulator import crowd_decisions
from studies.learn_together import run as study

VIEW = study.VIEW


@pytest.fixture(scope="module")
def onnx():
    return pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")


@pytest.mark.slow
def test_the_crowd_acts_as_the_network_of_the_vehicle_does(onnx):
    env = parallel_env(study.SCENARIO, **VIEW)
    seen, _ = env.reset(options={"case": "val/3"})
    policy, planner = PEDESTRIANS.load("learned")[1], load_planner(str(study.TOGETHER))
    for _ in range(8):
        world = env._world
        velocity = policy.velocities(world, {})[0]
        observed = np.stack([seen[agent] for agent in env.agents])
        actions = np.clip(planner.function(observed), -1.0, 1.0)
        after = env.step(dict(zip(env.agents, actions.astype(float), strict=True)))
        moved = env._world.velocity[0, 1:]
        np.testing.assert_allclose(moved, velocity, atol=1e-5)
        seen = after[0]


@pytest.mark.slow
def test_the_crowd_is_one_by_name():
    scenario = load_scenario(study.SCENARIO, pedestrians="learned")
    world = scenario.draw("val", np.arange(40))
    assert list(scenario.policies) == ["learned"]
    together = crowd_decisions(world, scenario.policies)[0]
    for case in (0, 17, 39):
        alone = crowd_decisions(world.take(np.array([case])), scenario.policies)[0]
        np.testing.assert_array_equal(alone[0], together[case])
    assert (np.linalg.norm(together, axis=2) <= world.preferred_speed[:, 1:] + 1e-12).all()


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")
def test_both_networks_learn_and_the_page_has_a_row_for_each_vehicle(onnx, tmp_path, monkeypatch, capsys):
    pytest.importorskip("supersuit", reason="pip install supersuit")
    for name in ("TOGETHER", "WITH_ORCA", "WEIGHTS"):
        monkeypatch.setattr(study, name, tmp_path / Path(getattr(study, name)).name)
    monkeypatch.setattr(study, "VEHICLES", (str(study.WITH_ORCA), str(study.TOGETHER), "straight"))
    monkeypatch.setattr(sys, "argv", ["run.py", "--train", "0.1", "--cases", "val:4", "--out", str(tmp_path / "runs")])
    with pytest.raises(SystemExit) as stop:
        main(study.cross_play)
    assert not stop.value.code
    assert study.WEIGHTS.exists()
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert [row[0] for row in rows[2:5]] == ["| with_orca", "| together", "| straight"]
    assert rows[0][1:] == ["pedestrians=orca", "pedestrians=social_force", "pedestrians=learned |"]
