"""A run is simulated again from its commands: honest runs agree, forged ones are named."""

import dataclasses
import json
import os
import shutil
import signal
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers import Still, make, reseal

from crowdbench.catalog import load_recorded_scenario, load_scenario
from crowdbench.cli.app import app
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS
from crowdbench.metrics.user_metrics import load_metrics
from crowdbench.planners.planner import Planner
from crowdbench.results.episodes import Episodes
from crowdbench.results.run_result import RunResult
from crowdbench.runs import rollout as rollouts
from crowdbench.runs import score as scores
from crowdbench.runs.merge import merge
from crowdbench.runs.run import Run
from crowdbench.runs.score import replay_run
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import step, step_pedestrians
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import plain

CASES = 12
SOME = {name: METRICS[name] for name in ("success_rate", "collision_rate", "path_length", "jerk", "discomfort")}


class Straight(Planner):
    def plan(self, obs):
        to_goal = obs.vehicle.goal - obs.vehicle.position
        return to_goal / np.linalg.norm(to_goal, axis=1)[:, None]

    def plan_ahead(self, obs, steps):
        return self.plan(obs)[:, None].repeat(steps, axis=1)


def go(out, planner="orca", cases=str(CASES), scenario="circle_crossing_5", **settings):
    loaded = load_scenario(scenario, settings.pop("overrides", {}), settings.pop("pedestrians", None))
    make(out, planner, loaded, cases, **{"metrics": SOME, "record": "failures"} | settings)
    return out


def again(directory, metrics=SOME, pedestrians=()):
    files = RunResult.read(directory)
    scenario = load_recorded_scenario(files.result["scenario"], "result.json", pedestrians)
    return replay_run(files, scenario, metrics)


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    return go(tmp_path_factory.mktemp("run") / "orca")


@pytest.fixture
def forged(honest, tmp_path):
    return shutil.copytree(honest, tmp_path / "forged")


def test_an_honest_run_agrees_to_the_last_bit(honest):
    found = again(honest)
    assert found.differences == []
    assert (len(found.episodes), found.versions) == (CASES, [])
    assert "All agree" in str(found)


MIXED = {
    "pedestrians.policy": {"orca": 0.7, "social_force": 0.2, "stroll.py": 0.1},
    "pedestrians.number": [0, 4],
    "pedestrians.radius": {"mean": 0.3, "std": 0.05, "low": 0.2, "high": 0.4},
    "vehicle.visible": True,
}

STROLL = """
import numpy as np
from crowdbench import PedestrianPolicy

class Stroll(PedestrianPolicy):
    parameters = {"pace": 0.5}

    def velocities(self, world, parameters):
        pace = parameters["pace"][:, 1:, None]
        return np.concatenate([pace, np.zeros_like(pace)], axis=2)

def policy():
    return Stroll()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"planner": Straight(), "replanning": Replanning(8)},
        {"overrides": {"collision": "crowdnav"}, "batch": 3, "record": "commands"},
        {"overrides": MIXED, "batch": 5, "record": "all", "cases": "val:8:16"},
        {"scenario": "circle_crossing_5_social_force", "cases": "497:503"},
        {"overrides": {"pedestrians.number": 0}, "cases": "2"},
    ],
)
def test_no_honest_run_is_accused(settings, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stroll.py").write_text(STROLL)
    found = again(
        go(tmp_path / "run", **settings), pedestrians=["stroll.py"] if settings.get("overrides") is MIXED else []
    )
    assert found.differences == []


def test_what_an_interrupted_run_kept_agrees(tmp_path, monkeypatch):
    measure = Run._measure

    def interrupted(run, trace):
        signal.raise_signal(signal.SIGINT)
        return measure(run, trace)

    with monkeypatch.context() as context:
        context.setattr(Run, "_measure", interrupted)
        with pytest.raises(KeyboardInterrupt):
            go(tmp_path / "run", batch=5)
    [folder] = tmp_path.glob("run.parts-*")
    merge(sorted(folder.iterdir()), tmp_path / "run")
    found = again(tmp_path / "run")
    assert (len(found.episodes), found.differences) == (5, [])


def rewrite(directory, episodes=None, **result):
    """Write other episodes with the summary that they have, and other keys of the result."""
    written = json.loads((directory / "result.json").read_text())
    if episodes is not None:
        episodes.write(directory / "episodes.csv")
        written |= {"outcomes": episodes.counts(), "metrics": plain(episodes.summary())}
    (directory / "result.json").write_text(json.dumps(written | result))


def all_succeed(directory):
    table = (directory / "episodes.csv").read_text()
    (directory / "episodes.csv").write_text(table.replace(",collision,", ",success,"))


def all_succeed_everywhere(directory):
    old = Episodes.read(directory / "episodes.csv")
    columns = dict(old.columns) | {
        "success_rate": np.ones(len(old), bool),
        "collision_rate": np.zeros(len(old), bool),
    }
    rewrite(directory, Episodes(old.case, np.full(len(old), int(Outcome.SUCCESS)), old.steps, columns))


def failures_deleted(directory):
    old = Episodes.read(directory / "episodes.csv")
    rewrite(directory, old.take(np.flatnonzero(old.columns["success_rate"])))


def failures_deleted_everywhere(directory):
    failures_deleted(directory)
    table = pq.read_table(directory / "commands.parquet")
    kept = np.isin(table["case"].to_numpy(), Episodes.read(directory / "episodes.csv").case)
    pq.write_table(table.filter(pa.array(kept)), directory / "commands.parquet")
    (directory / "run.rrd").unlink()


def shorter_paths(directory):
    old = Episodes.read(directory / "episodes.csv")
    rewrite(
        directory, dataclasses.replace(old, columns={**old.columns, "path_length": old.columns["path_length"] * 0.9})
    )


def better_summary(directory):
    metrics = json.loads((directory / "result.json").read_text())["metrics"]
    metrics["jerk"]["mean"] *= 0.5
    rewrite(directory, metrics=metrics)


def rewrite_commands(directory, change):
    table = pq.read_table(directory / "commands.parquet")
    rows = [change(np.array(row)).tolist() for row in table["command"].to_pylist()]
    changed = table.set_column(1, table.schema.field(1), pa.array(rows, table.schema.field(1).type))
    pq.write_table(changed, directory / "commands.parquet")


def other_commands(directory):
    rewrite_commands(directory, lambda row: row * 0.9)


def fast_commands(directory):
    rewrite_commands(directory, lambda row: row * 1.5)


def fewer_commands(directory):
    rewrite_commands(directory, lambda row: row[:-2])


def another_recording(directory):
    shutil.copy(go(directory.parent / "other", Straight()) / "run.rrd", directory)


def fewer_recorded(directory):
    (directory / "run.rrd").unlink()


def rewrite_scenario(directory, digest, scenario):
    run = json.loads((directory / "result.json").read_text())["run"]
    rewrite(directory, run=run | {"scenario": digest}, scenario=scenario)


def other_seed(directory):
    scenario = load_scenario("circle_crossing_5", {"seed": 5, "crowdnav_cases": 0})
    rewrite_scenario(directory, scenario.digest, scenario={"name": scenario.name, **scenario.table})


def other_scenario(directory):
    scenario = load_scenario("square_crossing_5")
    rewrite_scenario(directory, scenario.digest, scenario={"name": scenario.name, **scenario.table})


def scenario_of_another_id(directory):
    scenario = load_scenario("circle_crossing_5", {"description": "another", "time_limit": 26.0})
    rewrite(directory, scenario={"name": scenario.name, **scenario.table})


@pytest.mark.parametrize(
    ("forge", "named"),
    [
        (all_succeed_everywhere, "cases end otherwise than episodes.csv says: test/"),
        (shorter_paths, "12 of 12 cases have other figures in episodes.csv: test/0 (path_length "),
        (other_commands, "cases end otherwise than episodes.csv says: test/0 ("),
        (another_recording, "episodes in run.rrd end otherwise: test/"),
        (other_seed, "cases end otherwise than episodes.csv says: test/"),
        (other_scenario, "cases end otherwise than episodes.csv says: test/"),
    ],
)
def test_a_forged_run_is_named(forge, named, forged):
    forge(forged)
    reseal(forged)
    found = again(forged)
    assert named in str(found)
    assert "All agree" not in str(found)


@pytest.mark.parametrize(
    ("forge", "named"),
    [
        (all_succeed, "_rate contradicts the outcomes"),
        (failures_deleted, "its cases differ from test:0:12"),
        (failures_deleted_everywhere, "its cases differ from test:0:12"),
        (better_summary, "metrics.jerk.mean is "),
        (fast_commands, "planner of the replay asked for .* m/s, but the vehicle's maximum"),
        (fewer_commands, "commands.parquet: its steps differ from episodes.csv"),
        (fewer_recorded, "contradicts files.run.rrd"),
        (scenario_of_another_id, "but its table scenario has the digest"),
    ],
)
def test_files_that_contradict_each_other_are_refused(forge, named, forged):
    forge(forged)
    reseal(forged)
    with pytest.raises(InputError, match=named):
        again(forged)


def goal_moved(monkeypatch):
    draw = Scenario.draw

    def nearer(self, split, cases):
        world = draw(self, split, cases)
        goal = world.goal.copy()
        goal[:, 0] = world.position[:, 0] + 0.5
        return world.replace(goal=goal)

    monkeypatch.setattr(Scenario, "draw", nearer)


def crowd_stopped(monkeypatch):
    def still(world, policies):
        return np.zeros_like(world.position[:, 1:]), world

    monkeypatch.setattr(rollouts, "crowd_decisions", still)


def judge_lenient(monkeypatch):
    def lenient(world, command, crowd, post_step_rule):
        after, check = step(world, command, crowd, post_step_rule)
        return after, check._replace(outcome=np.where(check.outcome == Outcome.COLLISION, 0, check.outcome))

    monkeypatch.setattr(rollouts, "step", lenient)


@pytest.mark.parametrize("forge", [goal_moved, crowd_stopped, judge_lenient])
def test_a_run_in_a_changed_simulator_is_named(forge, tmp_path, monkeypatch):
    with monkeypatch.context() as context:
        forge(context)
        go(tmp_path / "run", Straight())
    assert "cases end otherwise than episodes.csv says" in str(again(tmp_path / "run"))


def test_on_another_machine_the_last_bits_may_differ(forged):
    old = Episodes.read(forged / "episodes.csv")
    rewrite(forged, dataclasses.replace(old, columns={**old.columns, "jerk": old.columns["jerk"] * (1 + 1e-13)}))
    reseal(forged)
    assert "cases have other figures in episodes.csv: test/0 (jerk" in str(again(forged))
    stated = json.loads((forged / "result.json").read_text())["stated"]
    rewrite(forged, stated=stated | {"versions": {"python": "3.0"}})
    reseal(forged)
    found = again(forged)
    assert found.differences == []
    assert "outcomes exactly and figures to 1e-6" in str(found)
    assert "numpy is" in str(found)


def test_with_other_code_of_crowdbench_the_last_bits_may_differ(honest, monkeypatch):
    monkeypatch.setattr(scores, "code", lambda: "other")
    found = again(honest)
    assert found.versions == ["the code of crowdbench is another than in the run"]
    assert found.differences == []


def test_metrics_of_a_users_own_are_compared_if_they_are_given(tmp_path):
    (tmp_path / "steps_squared.py").write_text("def metric(trace): return trace.steps**2.0")
    metrics = SOME | {"steps_squared": load_metrics([str(tmp_path / "steps_squared.py")])["steps_squared"]}
    go(tmp_path / "run", cases="3", metrics=metrics, record="commands")
    known, unknown = again(tmp_path / "run", metrics), again(tmp_path / "run")
    assert (known.unchecked, unknown.unchecked) == ([], ["steps_squared"])
    assert (known.metrics, unknown.metrics) == (len(SOME) + 1, len(SOME))
    assert known.differences == unknown.differences == []


def test_only_policies_that_the_user_gives_are_loaded_from_files(tmp_path):
    policy = tmp_path / "stroll.py"
    policy.write_text(STROLL)
    go(tmp_path / "run", cases="3", pedestrians=str(policy))
    with pytest.raises(InputError, match=r"give it with --pedestrians \./stroll\.py"):
        again(tmp_path / "run")
    with pytest.raises(InputError, match="no pedestrian policy of the run is a file called other"):
        again(tmp_path / "run", pedestrians=[str(shutil.copy(policy, tmp_path / "other.py"))])
    policy.write_text(STROLL + "# changed")
    with pytest.raises(InputError, match=r"policy_files.stroll is \w+, but must be the digest of the file"):
        again(tmp_path / "run", pedestrians=[str(policy)])
    table = json.loads((tmp_path / "run" / "result.json").read_text())["scenario"]
    table["pedestrians"] = {"policy": str(policy)}
    with pytest.raises(InputError, match="is a file of a user"):
        load_recorded_scenario(table, "result.json")


def test_a_run_that_cannot_be_replayed_says_why(forged, tmp_path):
    (tmp_path / "x.rrd").touch()
    with pytest.raises(InputError, match="not the directory of a run"):
        RunResult.read(tmp_path / "x.rrd")
    commands = forged / "commands.parquet"
    whole = commands.read_bytes()

    def refused(match):
        reseal(forged)
        with pytest.raises(InputError, match=match):
            again(forged)

    commands.write_bytes(whole[:-100])
    refused("cut short, damaged or no Parquet file")
    pq.write_table(pa.table({"case": [1], "command": [[1.0, 2.0, 3.0]]}), commands)
    refused("values are missing")
    pq.write_table(pa.table({"case": [1]}), commands)
    refused("not a table of commands")
    commands.write_bytes(whole)
    run = json.loads((forged / "result.json").read_text())["run"]
    rewrite(forged, run=run | {"cases": "test:1000:1000000"})
    refused("its cases differ from test:1000")


def test_a_run_without_commands_cannot_be_replayed(tmp_path):
    with pytest.raises(InputError, match="was made with --record none"):
        again(go(tmp_path / "run", cases="2", record="none"))


def test_the_command_says_what_differs_by_its_exit_status_too(forged, capsys):
    app(["score", str(forged)], standalone_mode=False)
    assert "All agree" in capsys.readouterr().out
    all_succeed_everywhere(forged)
    reseal(forged)
    with pytest.raises(SystemExit, match="1"):
        app(["score", str(forged), "--json"], standalone_mode=False)
    told = json.loads(capsys.readouterr().out)["comparison"]
    assert told["agrees"] is False
    assert "cases end otherwise than episodes.csv says" in [one["what"] for one in told["differences"]]


def test_a_replay_does_not_need_the_planner(tmp_path):
    go(tmp_path / "run", Still(), cases="2")
    assert again(tmp_path / "run").differences == []


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse the name")
def test_the_name_of_a_directory_need_not_be_utf_8(tmp_path):
    directory = tmp_path / os.fsdecode(b"\xff")
    go(directory, cases="2", record="commands")
    assert not again(directory).differences


@pytest.mark.parametrize(("names", "expected"), [(["jerk"], False), (["jerk", "deflection"], True)])
def test_a_replay_simulates_the_undisturbed_crowd_for_metrics_that_need_it(names, expected, tmp_path, monkeypatch):
    metrics = {name: METRICS[name] for name in names}
    run = go(tmp_path / "run", cases="4", scenario="circle_crossing_5_visible", metrics=metrics, record="all")
    walks = []
    monkeypatch.setattr(
        rollouts, "step_pedestrians", lambda *arguments: walks.append(arguments) or step_pedestrians(*arguments)
    )
    found = again(run, metrics)
    assert (found.differences, bool(walks)) == ([], expected)
