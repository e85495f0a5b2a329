import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import Still, drive, make, reseal

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli.app import app
from crowdbench.cli.console import print_table
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.record.recorded_cases import recorded_outcomes
from crowdbench.results.compare import compare, comparison_grid
from crowdbench.results.episodes import Episodes, planner_label, read_estimate
from crowdbench.results.paired import mcnemar
from crowdbench.results.result_file import read_result
from crowdbench.results.table import metric_grid
from crowdbench.runs import rollout
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec, directory_name
from crowdbench.scenario.cases import Cases
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, Interrupted
from crowdbench.utils.files import new_directory


def go(out, planner="orca", cases="30", **settings):
    scenario = load_scenario("circle_crossing_5", settings.pop("overrides", {}))
    make(out, planner, scenario, cases, **{"record": "none"} | settings)
    return read_result(out) if (out / "result.json").exists() else None


def test_a_result_says_what_was_run_and_what_came_out(tmp_path):
    written = go(tmp_path / "a", overrides={"collision": "crowdnav"})
    result = read_result(tmp_path / "a")
    assert result == written
    assert (result["run"]["planner"]["name"], result["run"]["cases"]) == ("orca", "test:0:30")
    assert result["scenario"]["collision"] == "crowdnav"
    assert result["scenario"]["name"] == "circle_crossing_5"
    assert set(result["metrics"]) == set(METRICS)
    rate = result["metrics"]["success_rate"]
    assert rate["low"] < rate["mean"] < rate["high"]
    assert rate["mean"] == result["outcomes"]["success"] / 30
    assert "decision_ms_per_step" in result["stated"]["timing"]
    assert not any("time" in name and "decision" in name for name in result["metrics"])


def test_episodes_read_back_to_the_last_bit(tmp_path):
    episodes = Episodes.of(drive("orca", "20"), METRICS)
    episodes.write(tmp_path / "episodes.csv")
    again = Episodes.read(tmp_path / "episodes.csv")
    assert np.array_equal(again.outcome, episodes.outcome)
    assert list(again.columns) == list(episodes.columns)
    for name, values in episodes.columns.items():
        assert np.array_equal(again.columns[name], values, equal_nan=values.dtype != bool)
    header, first = (tmp_path / "episodes.csv").read_text().splitlines()[:2]
    assert header.startswith("case,outcome,steps,success_rate")
    assert first.split(",")[1] in {outcome.label for outcome in Outcome}


def test_an_earlier_run_is_not_overwritten_unasked(tmp_path):
    go(tmp_path / "a", cases="3")
    with pytest.raises(InputError, match="--overwrite"):
        go(tmp_path / "a", cases="4")
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:3"
    go(tmp_path / "a", cases="4", overwrite=True)
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:4"
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").touch()
    with pytest.raises(InputError, match="holds something other than a run"):
        go(tmp_path / "thesis", cases="3", overwrite=True)


def test_the_first_of_two_runs_to_one_place_stays(tmp_path):
    with pytest.raises(InputError, match="written by another run"), new_directory(tmp_path / "a", False):
        go(tmp_path / "a", cases="3")
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:3"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_a_killed_run_left_is_cleared_away_but_not_a_live_one(tmp_path):
    (tmp_path / ".a.partial-0000dead").mkdir()
    (tmp_path / ".a.lock-0000dead").touch()
    (tmp_path / ".a.earlier-dead").mkdir()
    (tmp_path / ".a.earlier-dead" / "result.json").write_text("{}")
    with new_directory(tmp_path / "a", True) as live:
        assert (tmp_path / "a" / "result.json").read_text() == "{}"
        go(tmp_path / "a", cases="3", overwrite=True)
        assert live.is_dir()
        assert {path.name for path in tmp_path.iterdir()} == {"a", live.name, live.name.replace("partial", "lock")}
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


WRITES_UNTIL_KILLED = """
import sys, time
from pathlib import Path
from crowdbench.utils.files import new_directory
with new_directory(Path(sys.argv[1]), False) as directory:
    (directory / "episodes.csv").write_text("half")
    print("written", flush=True)
    time.sleep(60)
"""


def test_a_run_killed_by_force_blocks_no_later_one(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", WRITES_UNTIL_KILLED, str(tmp_path / "a")], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "written\n"
        left = {path.name.rpartition("-")[0] for path in tmp_path.iterdir()}
        go(tmp_path / "a", cases="3")
        assert {path.name.rpartition("-")[0] for path in tmp_path.iterdir()} == left | {""}
        process.kill()
    assert left == {".a.partial", ".a.lock"}
    go(tmp_path / "a", cases="4", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_run_that_was_killed_while_it_was_replaced_keeps_its_name(tmp_path):
    go(tmp_path / "a", cases="3")
    (tmp_path / "a").rename(tmp_path / ".a.earlier-dead")
    # Refused at once, not after all cases are driven.
    with pytest.raises(InputError, match="exists already"):
        go(tmp_path / "a", Breaks(AssertionError()), cases="10:20")
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:3"
    (tmp_path / ".a.earlier-dead").mkdir()
    go(tmp_path / "a", cases="4", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_failed_move_leaves_the_earlier_run(tmp_path, monkeypatch):
    go(tmp_path / "a", cases="3")
    rename = Path.rename

    def fails_for_the_new_one(self, target):
        if ".partial-" in self.name:
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails_for_the_new_one)
    with pytest.raises(InputError, match="No space left"):
        go(tmp_path / "a", cases="4", overwrite=True)
    assert read_result(tmp_path / "a")["run"]["cases"] == "test:0:3"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_place_that_cannot_be_is_told(tmp_path):
    (tmp_path / "file").touch()
    for name, expected in (("file", "is a file"), ("x" * 300, "cannot be written"), ("file/run", "cannot be written")):
        with pytest.raises(InputError, match=expected):
            go(tmp_path / name, cases="3", overwrite=True)


@pytest.mark.parametrize(
    ("cases", "changes", "expected"),
    [
        ("500", {}, "orca-square-500"),
        ("50:100", {}, "orca-square-50-100"),
        ("val:100", {"dt": 0.1, "x": "./a b.py"}, "orca-square-val-100-dt=0.1-x=._a_b.py"),
    ],
)
def test_directories_are_told_apart_by_what_was_run(cases, changes, expected):
    assert directory_name("orca", "square", RunSpec("orca", "square", Cases.parse(cases), options=changes)) == expected


class Breaks(Planner):
    """Raises `error` in a batch."""

    def __init__(self, error, batch=2):
        self.error = error
        self.left = batch

    def reset(self, rows):
        self.left -= 1

    def plan(self, obs):
        if not self.left:
            raise self.error
        return np.zeros((len(obs), 2))


@pytest.mark.slow
def test_an_error_leaves_nothing_behind_but_finished_batches(tmp_path):
    for out in (tmp_path / "a", tmp_path / "runs" / "a"):
        with pytest.raises(InputError, match="ZeroDivisionError"):
            go(out, Breaks(ZeroDivisionError(), batch=1), batch=10)
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(
        InputError,
        match=r"ZeroDivisionError, in line (.|\n)*10 of 30 cases are kept in .*parts-",
    ):
        go(tmp_path / "runs" / "a", Breaks(ZeroDivisionError()), batch=10)
    go(tmp_path / "runs" / "a", cases="3")
    assert [path.name[:8] for path in sorted((tmp_path / "runs").iterdir())] == ["a", "a.parts-"]
    go(tmp_path / "runs" / "a", Breaks(None, batch=99), batch=10, overwrite=True)
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["a"]


def test_an_interrupt_that_a_planner_raises_is_its_error(tmp_path):
    with pytest.raises(InputError, match=r"planner \w+ raised KeyboardInterrupt"):
        go(tmp_path / "a", Breaks(KeyboardInterrupt(), batch=1), batch=10)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_keeps_the_finished_batches(tmp_path):
    with pytest.raises(KeyboardInterrupt, match=r"^\n?10 of 30 cases are kept in .*/a\.parts-[0-9a-f]{8}-none; the"):
        go(tmp_path / "a", Breaks(Interrupted()), batch=10)
    assert not (tmp_path / "a").exists()
    with pytest.raises(KeyboardInterrupt, match=r"^$"):
        go(tmp_path / "b", Breaks(Interrupted(), batch=1), cases="10")
    assert [path.name[:7] for path in tmp_path.iterdir()] == ["a.parts"]


def test_an_interrupt_waits_until_a_batch_is_written(tmp_path, monkeypatch):
    measure = Run._measure

    def interrupted(run, trace):
        signal.raise_signal(signal.SIGINT)
        return measure(run, trace)

    monkeypatch.setattr(Run, "_measure", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"^\n?10 of 30 cases are kept"):
        go(tmp_path / "a", batch=10, record="all")
    [part] = tmp_path.glob("a.parts-*/test-0-10")
    assert read_result(part)["recorded"] == 10
    assert len(recorded_outcomes(part / "run.rrd")) == 10
    # What is asked for after the last batch comes too late: everything is there.
    assert go(tmp_path / "b", cases="10")["run"]["cases"] == "test:0:10"


@pytest.mark.slow
def test_the_resampled_difference_is_paired(tmp_path):
    go(tmp_path / "a", cases="60")
    go(tmp_path / "b", cases="60")
    table = (tmp_path / "b" / "episodes.csv").read_text().splitlines()
    at = table[0].split(",").index("path_length")
    rows = [line.split(",") for line in table[1:]]
    for row in rows:
        row[at] = repr(float(row[at]) + 2.0)
    (tmp_path / "b" / "episodes.csv").write_text("\n".join([table[0], *map(",".join, rows)]) + "\n")
    stated = read_result(tmp_path / "b")["metrics"]["path_length"]
    longer = {name: stated[name] + 2.0 for name in ("mean", "low", "high", "max")}
    reseal(tmp_path / "b", lambda result: result["metrics"]["path_length"].update(longer))
    difference = compare(tmp_path / "a", tmp_path / "b").rows["path_length"].difference
    assert (difference.low, difference.mean, difference.high) == pytest.approx((2.0, 2.0, 2.0))


def test_a_directory_appears_whole_or_not_at_all(tmp_path):
    def write(directory):
        (directory / "x").write_text("half")
        assert not (tmp_path / "a").exists()
        raise RuntimeError

    with pytest.raises(RuntimeError), new_directory(tmp_path / "a", False) as partial:
        write(partial)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="cannot be written"), new_directory(tmp_path / "b", False):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("metric", "expected"),
    [
        (lambda trace: 1 / 0, "metric mine raised ZeroDivisionError"),
        (lambda trace: np.full(len(trace), np.inf), "metric mine is inf in case 0, but must not be"),
        (lambda trace: np.full(len(trace), -1e308), "metric mine is -1e\\+308 in case 0, but must not be"),
        (lambda trace: sys.exit(), "metric mine raised SystemExit"),
        (lambda trace: 3.0, "metric mine returned float"),
        (lambda trace: trace.gap, "metric mine returned shape"),
        (lambda trace: np.array(["a"] * len(trace)), "metric mine returned shape"),
    ],
)
def test_a_broken_metric_gets_one_sentence(tmp_path, metric, expected):
    with pytest.raises(InputError, match=expected):
        go(tmp_path / "a", cases="3", metrics={"mine": metric})


def test_only_booleans_are_rates_whatever_a_metric_is_called(tmp_path, capsys):
    def mistake_rate(trace):
        """Mistakes in a minute [1/min]."""
        return np.full(len(trace), 3.5)

    metrics = {"success_rate": METRICS["success_rate"], "mistake_rate": mistake_rate}
    result = go(tmp_path / "a", cases="6", metrics=metrics)
    assert result["rates"] == ["success_rate"]
    found = {name: read_estimate(table) for name, table in result["metrics"].items()}
    print_table(metric_grid("", found, result["rates"], metrics))
    shown = capsys.readouterr().out
    assert re.search(r"success +success_rate +[\d.]+ %", shown)
    assert re.search(r"mistake +mistake_rate +3\.500 1/min", shown)
    print_table(comparison_grid([compare(tmp_path / "a", tmp_path / "a")]))
    compared = capsys.readouterr().out
    assert re.search(r"success, % +[\d.]+ +[\d.]+ +0\.0 \(", compared)


def test_a_run_shows_its_main_metrics_and_how_to_see_its_failures(tmp_path, capsys):
    out = str(tmp_path / "run")
    app(["run", "--planner", "straight", "--cases", "4", "--out", out], standalone_mode=False)
    shown = capsys.readouterr().out
    table = shown.partition(" metrics in all")[0]
    titles = [line.partition("  ")[0] for line in table.splitlines()[2:] if "  " in line]
    assert titles == ["score", "success", "collisions", "at fault", "timeouts", "jerk"]
    assert f"4 collisions (cases 0, 1, 2, 3): crowdbench view {out} --case 0" in shown
    app(
        ["run", "--planner", "straight", "--cases", "4", "--out", out, "--overwrite", "--all-metrics"],
        standalone_mode=False,
    )
    assert len(capsys.readouterr().out.splitlines()) > len(shown.splitlines()) + 10


def test_a_failure_can_be_viewed_where_commands_are_kept_and_a_run_without_any_says_nothing(tmp_path, capsys):
    out = str(tmp_path / "run")
    app(["run", "--planner", "straight", "--cases", "4", "--record", "commands", "--out", out], standalone_mode=False)
    assert capsys.readouterr().out.endswith(f"4 collisions (cases 0, 1, 2, 3): crowdbench view {out} --case 0\n")
    given = ["run", "--planner", "straight", "--cases", "4", "--record", "none", "--out", out, "--overwrite"]
    app(given, standalone_mode=False)
    assert capsys.readouterr().out.endswith(f"Kept in {out}; no episode is recorded\n")
    empty = ["--set", "pedestrians.number=0", "--cases", "2", "--out", str(tmp_path / "empty")]
    app(["run", "--planner", "straight", *empty], standalone_mode=False)
    assert capsys.readouterr().out.endswith("(crowdbench view shows them)\n")


@pytest.mark.parametrize(
    "table",
    [
        "case,outcome,steps\n0,success," + "1" * 150_000,
        "case,outcome,steps\n0,success," + "1" * 30,
        "case,outcome,steps,mine\n0,success,1,1e308",
        "case,outcome,steps,mine,mine\n0,success,1,1,2",
        "case,outcome,steps",
        "",
    ],
)
def test_a_table_that_is_none_of_crowdbench_gets_one_sentence(tmp_path, table):
    (tmp_path / "episodes.csv").write_text(table)
    with pytest.raises(InputError, match="is no table of episodes"):
        Episodes.read(tmp_path / "episodes.csv")


class Verbose(ORCAPlanner):
    """Logs futures of two kilobytes."""

    def plan(self, obs):
        obs.log("future", np.ones((len(obs), 8, 16, 2)))
        return super().plan(obs)


@pytest.mark.slow
def test_a_planner_that_logs_much_runs_in_smaller_batches(tmp_path, monkeypatch):
    go(tmp_path / "a", Verbose(), record="failures")
    batches = []
    monkeypatch.setattr(rollout, "LOG_MEMORY", 7 * 97 * 8 * 16 * 2 * 4)
    monkeypatch.setattr(Verbose, "reset", lambda self, rows: batches.append(len(rows)))
    go(tmp_path / "b", Verbose(), record="failures")
    assert batches == [30, 7, 7, 7, 7, 2]
    assert (tmp_path / "a" / "episodes.csv").read_bytes() == (tmp_path / "b" / "episodes.csv").read_bytes()
    assert recorded_outcomes(tmp_path / "b" / "run.rrd") == recorded_outcomes(tmp_path / "a" / "run.rrd")
    monkeypatch.setattr(rollout, "LOG_MEMORY", 1)
    batches.clear()
    go(tmp_path / "c", Verbose(), cases="3", record="failures")
    assert batches == [3, 1, 1, 1]


def test_a_comparison_is_paired_by_case(tmp_path):
    go(tmp_path / "a", cases="40")
    go(tmp_path / "b", Still(), cases="10:50")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert (found.cases, found.both_solved) == (30, 0)
    outcome = drive("orca", "10:40").outcome
    solved = int((outcome == Outcome.SUCCESS).sum())
    rate = found.rows["success_rate"]
    assert (rate.a, rate.b) == (solved / 30, 0.0)
    assert rate.difference.mean == pytest.approx(-solved / 30)
    assert rate.p == pytest.approx(2 * 0.5**solved)
    changed = [case for case, *_ in found.changed]
    assert changed == [case for case, one in zip(range(10, 40), outcome, strict=True) if one != Outcome.TIMEOUT]
    limit = found.rows["navigation_time_or_limit"]
    assert limit.b == 25.0
    assert limit.a < 25.0
    assert limit.difference.n == 30
    same = compare(tmp_path / "a", tmp_path / "a")
    assert same.changed == []
    assert same.rows["success_rate"].p == 1.0
    assert same.rows["navigation_time"].difference.mean == 0.0


def test_mcnemar_counts_only_cases_that_differ():
    a = np.array([True] * 12 + [False] * 5)
    b = np.array([True] * 2 + [False] * 15)
    assert mcnemar(a, b) == pytest.approx(2 * 0.5**10)
    assert mcnemar(a, a) == 1.0


@pytest.mark.slow
def test_runs_that_cannot_be_compared_are_told_why(tmp_path):
    go(tmp_path / "a", cases="5")
    go(tmp_path / "b", cases="5", overrides={"vehicle.visible": True})
    go(tmp_path / "c", cases="5:9")
    go(tmp_path / "d", cases="val:5")
    with pytest.raises(InputError, match=r"different scenarios, in vehicle\.visible:"):
        compare(tmp_path / "a", tmp_path / "b")
    with pytest.raises(InputError, match="share no case"):
        compare(tmp_path / "a", tmp_path / "c")
    with pytest.raises(InputError, match="val cases"):
        compare(tmp_path / "a", tmp_path / "d")
    with pytest.raises(InputError, match="not the directory of a run"):
        compare(tmp_path / "a", tmp_path / "nowhere")
    (tmp_path / "a" / "episodes.csv").write_text("case,outcome\n1,sucess\n")
    reseal(tmp_path / "a")
    with pytest.raises(InputError, match="no table of episodes"):
        compare(tmp_path / "a", tmp_path / "c")


@pytest.mark.slow
def test_a_pooled_metric_is_compared_pooled(tmp_path):
    go(tmp_path / "a", cases="40")
    go(tmp_path / "b", load_planner("orca", {"safety_space": 0.1}), cases="40")
    row = compare(tmp_path / "a", tmp_path / "b").rows["discomfort_frequency"]
    tables = [Episodes.read(tmp_path / name / "episodes.csv") for name in "ab"]
    solved = tables[0].columns["success_rate"] & tables[1].columns["success_rate"]
    expected = [
        np.average(table.columns["discomfort_frequency"][solved], weights=table.steps[solved]) for table in tables
    ]
    assert (row.a, row.b) == pytest.approx(expected, abs=1e-12)
    assert row.difference.low < row.difference.mean < row.difference.high


def test_labels_show_options_as_they_are_written_in_toml():
    options = {"modes": 5, "limits": {"max_velocity_change": 1.0}, "explore": False}
    label = planner_label("sarl", {**options, "replan_every": 8, "look_first": 1})
    assert label == "sarl (modes=5, limits={max_velocity_change=1.0}, explore=false, replan_every=8, look_first=1)"
    assert planner_label("orca", {}) == "orca"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc, where nobody can make a file")
def test_where_nothing_can_be_written_a_run_says_so_and_does_not_wait():
    command = [sys.executable, "-m", "crowdbench", "run", "--planner", "orca", "--cases", "2", "--out", "/proc/x"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 1
    assert "/proc/x cannot be written" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_file_system_without_locks_does_without(tmp_path, monkeypatch):
    def acquire(self):
        raise NotImplementedError

    monkeypatch.setattr(files.FileLock, "acquire", acquire)
    with new_directory(tmp_path / "run", False) as partial:
        (partial / "result.json").write_text("{}")
    assert (tmp_path / "run" / "result.json").exists()
