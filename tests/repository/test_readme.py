"""What the README and the documentation show works as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import drive, failed_checks
from torch import nn

from crowdbench import export_policy
from crowdbench.catalog import PEDESTRIANS, load_planner, load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import PLANNER, POLICY, SCENARIO
from crowdbench.cli.app import app
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.scenario.cases import Cases

ROOT = Path(__file__).parents[2]


def blocks(file):
    return re.findall(r"^```python\n(.*?)^```", (ROOT / file).read_text(), re.DOTALL | re.MULTILINE)


def block(file, sign):
    """The block of Python in a file that has a text in it."""
    (text,) = [block for block in blocks(file) if sign in block]
    return text


def test_the_planner_of_the_readme_keeps_the_contract(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(blocks("README.md")[0])
    place = load_scenario("circle_crossing_5")
    assert not failed_checks(Subject(PLANNER, lambda: load_planner(str(path)), "mine", {"": place}, neural=False))


def test_the_composition_of_the_docs_drives(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(block("docs/planner.md", "ValuePlanner"))
    planner = load_planner(str(path))
    assert {planner.facts["network"], *planner.facts} == {"sarl", "network", "weights"}


def test_the_environments_of_the_docs_start():
    import gymnasium

    names = {}
    exec(block("docs/training.md", "gymnasium.make_vec"), names)
    assert names["info"]["case"] == 37
    assert names["many"].num_envs == 64
    assert isinstance(names["vehicle"], gymnasium.Env)


@pytest.mark.parametrize(("name", "parameters"), [("stroll", {"pace": 0.5}), ("tired", {})])
def test_the_policies_of_the_docs_keep_the_contract(name, parameters, tmp_path):
    path = tmp_path / f"{name}.py"
    path.write_text(block("docs/plugins.md", f"class {name.title()}"))
    loaded, policy = PEDESTRIANS.load(str(path))
    assert (loaded, policy.parameters) == (name, parameters)
    place = load_scenario("circle_crossing_5", {"time_limit": 3.0}, str(path))
    assert not failed_checks(Subject(POLICY, lambda: PEDESTRIANS.load(str(path))[1], name, {"": place}, neural=False))


@pytest.mark.parametrize(
    ("page", "sign", "kind"),
    [
        ("planner", "class Waits", "planners"),
        ("planner", "def decide(", "planners"),
        ("plugins", "def metric(", "metrics"),
        ("plugins", "class Slows", "predictors"),
    ],
)
def test_the_plug_ins_of_the_docs_keep_the_contract(page, sign, kind, tmp_path, capsys):
    path = tmp_path / "mine.py"
    path.write_text(block(f"docs/{page}.md", sign))
    app(["check", str(path), "--kind", kind, "--cases", "val:4"], standalone_mode=False)
    said = capsys.readouterr().out
    assert said.count("passed") == 3
    assert "failed" not in said


def test_the_reward_of_the_docs_pays(tmp_path):
    from crowdbench.envs.vector import VehicleVectorEnv

    (tmp_path / "mine.py").write_text(block("docs/plugins.md", "def reward("))
    mine, built_in = (VehicleVectorEnv(20, reward=reward) for reward in (str(tmp_path / "mine.py"), "progress"))
    for envs in (mine, built_in):
        envs.reset(seed=0)
    difference = 0.0
    for _ in range(20):
        paid, expected = (envs.step(np.tile([0.0, 1.0], (20, 1)))[1] for envs in (mine, built_in))
        assert (paid <= expected).all()
        difference += (expected - paid).sum()
    assert difference > 0.0


def test_the_function_of_the_docs_drives():
    names = {}
    exec(block("docs/training.md", "PolicyPlanner("), names)
    assert names["result"].metrics["timeout_rate"].mean == 0.0  # it drives to the goal, or into somebody


COMMANDS = [
    command
    for page in ("README.md", "docs/commands.md")
    for command in re.findall(r"`crowdbench (run [^`]*)`", (ROOT / page).read_text())
    if "--workers" not in command and "--engine" not in command  # these run in tests/commands/test_workers.py
]


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_the_runs_that_are_shown_run(command, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(blocks("README.md")[0])
    if "policy.onnx" in command:
        for package in ("onnxruntime", "onnxscript"):
            pytest.importorskip(package, reason=f"{package} is not installed: pip install 'crowdbench[onnx]'")
        env = VehicleEnv()
        export_policy(nn.Linear(*env.observation_space.shape, 2), "policy.onnx", env)
    app([*command.split(), "--cases", "val:3", "--record", "none"], standalone_mode=False)
    assert "\nsuccess " in capsys.readouterr().out
    assert len(list(Path("runs").glob("*/episodes.csv"))) == 1


def test_the_scenario_of_the_docs_loads(tmp_path):
    text = re.search(r"^```toml\n(.*?)^```", (ROOT / "docs/scenario.md").read_text(), re.DOTALL | re.MULTILINE)[1]
    (tmp_path / "mine.toml").write_text(text)
    place = load_scenario(str(tmp_path / "mine.toml"))
    assert place.crowd.number == (1, 8)
    assert set(place.policies) == {"orca", "social_force"}
    assert place.crowd.preferred_speed.std == 0.2


def test_the_layout_of_the_docs_keeps_the_contract(tmp_path):
    (tmp_path / "pillar.py").write_text(blocks("docs/layouts.md")[0])
    (tmp_path / "mine.toml").write_text('[layout]\ngenerator = "./pillar.py"\n')
    place = load_scenario(str(tmp_path / "mine.toml"), {"layout.size": 1.5})
    assert not failed_checks(Subject(SCENARIO, lambda: place, "pillar", {"": place}))
    start = place.worlds(Cases.parse("2"))
    assert start.obstacles.max() == 0.75
    assert np.isfinite(start.route[:, :2, 0]).all()


def test_the_layout_that_draws_people_again_in_the_docs_keeps_the_contract(tmp_path):
    (tmp_path / "ring.py").write_text(blocks("docs/layouts.md")[1])
    (tmp_path / "mine.toml").write_text('[layout]\ngenerator = "./ring.py"\n[pedestrians]\narrival = "respawn"\n')
    place = load_scenario(str(tmp_path / "mine.toml"), {"pedestrians.preferred_speed": 2.0})
    assert not failed_checks(Subject(SCENARIO, lambda: place, "ring", {"": place}))
    trace = drive("orca", "3", str(tmp_path / "mine.toml"), pedestrians__preferred_speed=2.0)
    new = np.diff(trace.person, axis=1) != 0
    assert new.any()
    assert np.hypot(*trace.position[:, 1:, 1:][new].T) == pytest.approx(4.0)
