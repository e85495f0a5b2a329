import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from crowdbench import catalog
from crowdbench.cases import Cases
from crowdbench.cli import app
from crowdbench.compare import compare
from crowdbench.errors import InputError
from crowdbench.metrics import METRICS
from crowdbench.results import EPISODES, Episodes, read_result
from crowdbench.run import run
from crowdbench.study.crowds import Pair
from crowdbench.study.file import read_study
from crowdbench.study.runs import missing
from crowdbench.study.tables import LEAST_SHARED, plain
from crowdbench.study.two_levels import two_level
from crowdbench.summary import RESAMPLES, bootstrap, interval
from crowdbench.types import Outcome

STUDIES = Path(__file__).parent.parent / "docs" / "studies"

# As a planner with networks: what the weights hold is another file's matter.
MINE = """
import json
from pathlib import Path
from crowdbench.reactive import ORCAPlanner

def planner(weights="one", margin=0.0):
    learned = json.loads(Path("weights.json").read_text())[weights]
    made = ORCAPlanner(learned + margin)
    made.facts = {"weights": str(learned)}
    return made
"""

SEEDS = """
[[seeds]]
title = "Learned planners"
cases = "10"
validation = "val:12"
variant = { title = "CrowdNav's rule", overrides = { collision = "crowdnav" } }

[[seeds.rows]]
planner = "./mine.py"
weights = ["one", "two"]
scenario = "circle_crossing_5"
reported = "99 %, 10.6 s"
"""

CROWDS = """
[[crowds]]
title = "Crowds"
cases = "8"
scenarios = ["circle_crossing_5", "square_crossing_5"]
planners = ["orca", "orca_margin"]
"""


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE)
    Path("weights.json").write_text('{"one": 0.2, "two": 0.1}')


def read(text):
    Path("tiny.toml").write_text(text)
    return read_study(Path("tiny.toml"))


def study(text, *arguments):
    Path("tiny.toml").write_text(text)
    app(["study", "tiny.toml", *arguments], standalone_mode=False)


def made():
    """Name, and when it was made, of every run of the study."""
    return {path.name: path.stat().st_mtime_ns for path in Path("runs/study-tiny").iterdir()}


def episodes(success, **columns):
    """A table of episodes; a failure is a collision."""
    success = np.array(success, bool)
    columns = {name: np.array(values, float) for name, values in columns.items()}
    return Episodes(
        case=np.arange(len(success)),
        outcome=np.where(success, Outcome.SUCCESS, Outcome.COLLISION),
        steps=np.full(len(success), 40),
        columns={"success_rate": success, "collision_rate": ~success, "timeout_rate": success & ~success} | columns,
    )


def leave(run, out, table):
    """As if a run had left this table of episodes."""
    (out / run.directory).mkdir(parents=True)
    table.write(out / run.directory / EPISODES)


def test_the_bootstrap_draws_seeds_and_then_cases_for_all_seeds_alike():
    values = np.random.default_rng(7).normal(size=(4, 9))
    values[values > 1.0] = np.nan
    values[2] = np.nan

    def mean_of_means(rows):
        means = []
        for row in rows:
            numbers = [value for value in row if not math.isnan(value)]
            if numbers:
                means.append(sum(numbers) / len(numbers))
        return sum(means) / len(means) if means else None

    rng = np.random.default_rng(0)
    resampled = []
    for _ in range(RESAMPLES):
        seeds = rng.integers(4, size=4)
        cases = rng.integers(9, size=9)
        resampled.append(mean_of_means([[values[seed, case] for case in cases] for seed in seeds]))
    assert None in resampled
    expected = interval(np.array([value for value in resampled if value is not None]))
    found = two_level(values)
    assert (found.low, found.high) == pytest.approx(expected, abs=1e-12)
    assert found.mean == pytest.approx(mean_of_means(values))
    assert found.n == (~np.isnan(values)).sum()
    assert found.max == np.nanmax(values)


def test_the_bootstrap_is_as_wide_as_the_seeds_differ():
    values = np.repeat([[0.0], [0.5], [1.0]], 50, axis=1)
    every_draw = [np.mean(draw) for draw in itertools.product([0.0, 0.5, 1.0], repeat=3)]
    found = two_level(values)
    assert (found.low, found.high) == interval(np.tile(every_draw, 100)) == (0.0, 1.0)


def test_seeds_that_fail_in_the_same_cases_are_no_further_evidence():
    one = np.random.default_rng(3).random(200) < 0.8
    alone = bootstrap(one.astype(float), np.ones(200))
    together = two_level(np.tile(one.astype(float), (5, 1)))
    assert together.mean == alone.mean
    assert (together.low, together.high) == pytest.approx((alone.low, alone.high), abs=0.011)


def test_nothing_measured_gives_no_interval():
    found = two_level(np.full((2, 3), np.nan))
    assert found.n == 0
    assert math.isnan(found.mean)
    assert plain([found])[0]["low"] is None


def test_a_row_of_seeds_is_what_one_computes_by_hand(tmp_path):
    asked = read(SEEDS)
    (row,) = asked.tables[0].rows
    nan = math.nan
    leave(row.test[0], tmp_path, episodes([1] * 9 + [0], navigation_time=[10.0] * 8 + [19.0, nan]))
    leave(row.test[1], tmp_path, episodes([1] * 5 + [0] * 5, navigation_time=[12.0] * 5 + [nan] * 5))
    leave(row.variant[0], tmp_path, episodes([1] * 8 + [0] * 2))
    leave(row.variant[1], tmp_path, episodes([1] * 4 + [0] * 6))
    leave(row.validation, tmp_path, episodes([1] * 9 + [0] * 3, navigation_time=[9.5] * 9 + [nan] * 3))
    assert sorted(run.directory for run in asked.runs) == sorted(path.name for path in tmp_path.glob("mine-*"))
    text = asked.tables[0].fill(tmp_path).markdown()
    assert text.startswith("## Learned planners\n")
    header, _, line = [line for line in text.splitlines() if line.startswith("| ")]
    assert [cell.strip() for cell in header.strip("|").split("|")] == [
        "planner", "scenario", "seeds", "success", "time", "success, CrowdNav's rule",
        "shipped, val:0:12", "shipped, test:0:10", "reported",
    ]  # fmt: skip
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:3] == ["mine", "circle_crossing_5", "2"]
    assert re.fullmatch(r"70\.0 % \(\d\d\.\d to \d+\.\d\)", cells[3])
    assert re.fullmatch(r"11\.50 s \(10\.00 to 1\d\.\d\d\)", cells[4])
    assert cells[5].startswith("60.0 % (")
    assert cells[6:] == ["75.0 %, 9.50 s", "90.0 %, 11.00 s", "99 %, 10.6 s"]
    assert "\n- mine on circle_crossing_5: one 90.0 %, two 50.0 %\n" in text
    assert r"\*" not in text


def test_the_variant_and_the_cases_are_what_is_run():
    runs = read(SEEDS).tables[0].rows[0]
    assert [str(one.cases) for one in (*runs.test, *runs.variant, runs.validation)] == ["test:0:10"] * 4 + ["val:0:12"]
    rules = [one.scenario.rules.collision for one in (*runs.test, *runs.variant, runs.validation)]
    assert rules == ["swept"] * 2 + ["crowdnav"] * 2 + ["swept"]
    weights = [one.about["options"]["weights"] for one in (*runs.test, *runs.variant, runs.validation)]
    assert weights == ["one", "two", "one", "two", "one"]


def test_a_table_of_seeds_may_have_no_variant(tmp_path):
    asked = read("".join(line for line in SEEDS.splitlines(True) if not line.startswith("variant")))
    assert len(asked.runs) == 3
    for each in asked.runs:
        leave(each, tmp_path, episodes([1] * each.cases.stop, navigation_time=[9.0] * each.cases.stop))
    header, _, line = [line for line in asked.tables[0].fill(tmp_path).markdown().splitlines() if line.startswith("|")]
    assert "success, " not in header
    assert line.count("|") == header.count("|")


def test_a_label_replan_every_and_privilege_are_shown():
    Path("mine.py").write_text(MINE.replace("return made", "made.privileged = True; return made"))
    rows = read(SEEDS + "replan_every = 8\n").tables[0].rows
    assert (rows[0].planner, rows[0].validation.replan_every) == ("mine (replan_every=8)", 8)
    assert rows[0].validation.directory.startswith("mine-circle_crossing_5-val-12-weights=one-replan_every=8-")
    study(SEEDS.replace("reported", 'label = "trained | alone"\nreported'), "--out", "there")
    text = next(iter(read(Path("tiny.toml").read_text()).tables)).fill(Path("there")).markdown()
    assert r"| trained \| alone * | circle_crossing_5 |" in text
    assert text.splitlines()[-1].startswith(r"\* sees")


MEASURES = ("navigation_time", "discomfort", "jerk", "minimum_gap")


def side_by_side(**better):
    """Two runs of 20 cases, both solving the first 12; the second is smaller by `better` in the measures named."""
    success = [1] * 12 + [0] * 8
    noise = np.random.default_rng(5).normal(size=(2, 4, 20))
    one = {name: 5.0 + noise[0, i] for i, name in enumerate(MEASURES)}
    two = {name: one[name] + 0.1 * noise[1, i] - better.get(name, 0.0) for i, name in enumerate(MEASURES)}
    return episodes(success, **one), episodes(success, **two)


def test_a_pair_is_told_apart_by_the_measures_that_differ():
    pair = Pair.of(("a", "b"), *side_by_side(navigation_time=1.0, minimum_gap=0.5, jerk=-0.5))
    assert pair.better == {"navigation_time": "b", "minimum_gap": "a", "jerk": "a"}
    assert pair.cell() == "time +, jerk -, gap -"
    assert (pair.p, pair.both_solved) == (1.0, 12)
    assert Pair.of(("a", "b"), *side_by_side()).cell() == "none"


def test_success_tells_apart_by_mcnemar():
    columns = {name: np.ones(12) for name in MEASURES}
    all_of_them, most, half = (episodes([1] * n + [0] * (12 - n), **columns) for n in (12, 7, 6))
    assert Pair.of(("a", "b"), all_of_them, half).better == {"success_rate": "a"}
    assert Pair.of(("a", "b"), half, all_of_them).cell() == "success +"
    assert Pair.of(("a", "b"), half, all_of_them).p == 2 * 0.5**6
    assert Pair.of(("a", "b"), all_of_them, most).cell() == "none"


def test_a_few_shared_successes_are_no_evidence_and_the_cell_says_so():
    def pair(shared):
        columns = {name: np.ones(10) for name in MEASURES}
        success = [1] * shared + [0] * (10 - shared)
        slower = columns | {"navigation_time": np.full(10, 2.0)}
        return Pair.of(("a", "b"), episodes(success, **columns), episodes(success, **slower)).cell()

    assert pair(LEAST_SHARED) == "time -"
    assert pair(LEAST_SHARED - 1) == "none (5 solved by both)"
    assert pair(0) == "none (0 solved by both)"


def test_the_tables_of_a_crowd_are_what_one_computes_by_hand(tmp_path):
    table = read(CROWDS.replace('"8"', '"20"')).tables[0]
    for runs in table.by_scenario:
        one, two = side_by_side(navigation_time=1.0)
        # What a failure has says nothing of those who arrive.
        one.columns["minimum_gap"][12:] = -5.0
        one.columns["minimum_gap"][:12] = 0.25
        one.columns["discomfort"][:12] = 0.125
        leave(runs[0], tmp_path, one)
        leave(runs[1], tmp_path, two)
    text = table.fill(tmp_path).markdown()
    assert re.findall("^##+ .*", text, re.MULTILINE) == ["## Crowds", "### circle_crossing_5", "### square_crossing_5"]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    assert lines[0] == ["planner", "success", "collision", "time-out", "time", "discomfort", "jerk", "gap"]
    assert lines[2][:4] == ["orca", "60.0 % (38.7 to 78.1)", "40.0 %", "0.0 %"]
    time = bootstrap(one.columns["navigation_time"][:12], np.ones(12))
    assert lines[2][4] == f"{time.mean:.2f} s ({time.low:.2f} to {time.high:.2f})"
    assert lines[2][5] == "12.50 % (12.50 to 12.50)"
    assert lines[2][7] == "0.250 m (0.250 to 0.250)"
    assert lines[4] == ["told apart from", "orca"]
    assert lines[6][0] == "orca_margin"
    assert lines[6][1].startswith("time +")
    assert "The 5 tests in a crowd are not corrected" in text


def test_a_pair_differs_as_crowdbench_compare_says(tmp_path):
    table = read(CROWDS.replace('"8"', '"40"')).tables[0]
    for one in table.runs:
        one.make(tmp_path, lambda done: None)
    found = table.fill(tmp_path)
    for runs, crowd in zip(table.by_scenario, found.crowds, strict=True):
        expected = compare(*(tmp_path / one.directory for one in runs))
        (pair,) = crowd.pairs
        assert pair.both_solved == expected.both_solved > LEAST_SHARED
        assert pair.p == expected.rows["success_rate"].p
        for name, difference in pair.differences.items():
            row = expected.rows[name].difference
            assert (difference.mean, difference.low, difference.high) == pytest.approx((row.mean, row.low, row.high))
        rates = [entrant.success_rate.mean for entrant in crowd.planners]
        assert rates == [read_result(tmp_path / one.directory)["metrics"]["success_rate"]["mean"] for one in runs]


def test_only_what_is_missing_is_run(capsys):
    study(CROWDS)
    first = capsys.readouterr()
    before = made()
    assert "run 4 of 4: orca_margin on square_crossing_5, cases test:0:8" in first.err
    study(CROWDS.replace('["orca", "orca_margin"]', '["orca", "orca_margin", "social_force"]'))
    second = capsys.readouterr()
    assert "run 1 of 2: social_force on circle_crossing_5" in second.err
    study(CROWDS)
    again = capsys.readouterr()
    assert "run " not in again.err
    assert again.out == first.out
    assert len(made()) == 6
    assert before.items() <= made().items()
    names = [path.name for path in Path("runs/study-tiny").glob("*/*")]
    assert sorted(set(names)) == ["episodes.csv", "result.json"]


def digests(text):
    """What the names of the directories end in: all else in them is for people."""
    return {run.directory.rpartition("-")[2] for run in read(text).runs}


def test_whatever_changes_a_number_makes_another_run():
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 5\n")
    text = SEEDS.replace("circle_crossing_5", "./crowd.toml")
    before = digests(text)
    assert len(before) == 5
    assert digests(text.replace("99 %", "98 %").replace("Learned", "Trained")) == before
    for changed in ("options = { margin = 0.3 }", "replan_every = 2"):
        assert not digests(f"{text}{changed}\n") & before
    # Of the 5 runs so many stay: with other test cases, the one on validation cases.
    assert len(digests(text.replace('"10"', '"11"')) & before) == 1
    Path("weights.json").write_text('{"one": 0.2, "two": 0.3}')
    assert len(digests(text) & before) == 3
    Path("weights.json").write_text('{"one": 0.2, "two": 0.1}')
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 4\n")
    assert not digests(text) & before
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 5\n")
    assert digests(text) == before
    Path("mine.py").write_text(MINE + "# changed\n")
    assert not digests(text) & before


def test_a_run_that_was_interrupted_is_not_taken_for_the_whole(tmp_path):
    one = read(CROWDS).runs[0]
    run(one.driver, one.scenario, Cases.parse("5"), tmp_path / one.directory, metrics=METRICS, about=one.about)
    assert missing([one, one], tmp_path) == [one]
    one.make(tmp_path, lambda done: None)
    assert read_result(tmp_path / one.directory)["cases"] == "test:0:8"
    assert missing([one], tmp_path) == []
    assert len(one.episodes(tmp_path)) == 8


STOPS = """
import time
from pathlib import Path
import numpy as np
from crowdbench import Planner

class Stops(Planner):
    def plan(self, obs):
        while Path("wait").exists():
            Path("reached").touch()
            time.sleep(0.05)
        return np.zeros((len(obs), 2))

def planner():
    return Stops()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_study_goes_on_where_it_stopped(number, capsys):
    Path("stops.py").write_text(STOPS)
    text = CROWDS.replace('"orca_margin"', '"./stops.py"')
    Path("tiny.toml").write_text(text)
    Path("wait").touch()
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench", "study", "tiny.toml"],
        stderr=subprocess.PIPE,
        text=True,
        # A process started in the background ignores SIGINT unless told otherwise.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 100
    while not Path("reached").exists():
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, number)
    _, errors = process.communicate(timeout=60)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert errors.splitlines()[-1] == (
            "crowdbench: interrupted: the same command goes on with the runs that are kept in runs/study-tiny"
        )
    before = {name: when for name, when in made().items() if not name.startswith(".")}
    assert [name.partition("-")[0] for name in before] == ["orca"]
    Path("wait").unlink()
    study(text)
    assert "run 1 of 3: stops on circle_crossing_5" in capsys.readouterr().err
    assert before.items() <= made().items()
    assert len(made()) == 4


def test_json_has_the_numbers_of_the_tables(capsys):
    study(SEEDS + CROWDS)
    printed = capsys.readouterr().out
    study(SEEDS + CROWDS, "--json")
    found = json.loads(capsys.readouterr().out)
    assert found["study"] == "tiny"
    seeds, crowds = found["tables"]
    success = seeds["rows"][0]["success_rate"]
    assert "{mean:.1f} % ({low:.1f} to {high:.1f})".format_map({k: 100 * v for k, v in success.items()}) in printed
    assert seeds["rows"][0]["success_rates"][0] == seeds["rows"][0]["shipped_test"]["success_rate"]["mean"]
    assert [crowd["scenario"] for crowd in crowds["crowds"]] == ["circle_crossing_5", "square_crossing_5"]
    gap = crowds["crowds"][1]["planners"][1]["over_solved"]["minimum_gap"]
    assert "{mean:.3f} m ({low:.3f} to {high:.3f})".format_map(gap) in printed
    assert crowds["crowds"][0]["pairs"][0]["first"] == "orca"


BROKEN = {
    "": ["has no table", "[[seeds]] or [[crowds]]"],
    "[[seed]]": ["unknown key seed", "seeds", "crowds"],
    "[seeds]\ntitle = 'x'": ["seeds is", "list of tables"],
    CROWDS.replace("planners", "planer"): ["crowds[1].planners is missing", "list of texts"],
    CROWDS.replace('"orca_margin"', '"orca"'): ["crowds[1].planners", "none of them twice"],
    CROWDS.replace('"orca_margin"', '"./orca.py"'): ["crowds[1].planners", "different names"],
    CROWDS.replace('"orca_margin"', '"orka"'): ["in crowds[1], no planner is called 'orka'"],
    CROWDS.replace('"square_crossing_5"', '"square"'): ["in crowds[1], no scenario is called 'square'"],
    CROWDS.replace('["circle_crossing_5", "square_crossing_5"]', '"every"'): ["crowds[1].scenarios", '"all" or a list'],
    CROWDS.replace('"8"', '"many"'): ["in crowds[1], cases 'many'", "val:100"],
    CROWDS.replace('"8"', "8"): ["crowds[1].cases is 8", "text in quotes"],
    CROWDS + "record = 1": ["unknown key crowds[1].record", "the keys here are title, planners, scenarios, cases"],
    SEEDS.partition("[[seeds.rows]]")[0]: ["seeds[1].rows is missing", "one table or more"],
    SEEDS + "[[seeds.rows]]\nweights = ['a']": ["seeds[1].rows[2].planner is missing", "text in quotes"],
    SEEDS.replace('title = "CrowdNav\'s rule", ', ""): ["seeds[1].variant.title is missing"],
    SEEDS.replace("collision", "colision"): ["in seeds[1].rows[1]", "unknown key colision"],
    SEEDS.replace('["one", "two"]', "[]"): ["seeds[1].rows[1].weights is []", "list of texts"],
    SEEDS.replace("./mine.py", "orca"): ["in seeds[1].rows[1], orca has no option 'weights'"],
    SEEDS + "replan_every = 0": ["seeds[1].rows[1].replan_every is 0", "whole number"],
    SEEDS + "options = { weights = 'one' }": ["seeds[1].rows[1].options", "weights: they have a key of their own"],
    SEEDS + "options = { since = 2020-01-01 }": ["seeds[1].rows[1].options", "texts, numbers"],
    SEEDS + "options = 3": ["seeds[1].rows[1].options is 3", "{ key = 1.0 }"],
    "seeds = ": ["not valid TOML"],
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_study_gets_one_sentence(text):
    Path("orca.py").write_text((catalog.PLANNERS.folder / "orca.py").read_text())
    with pytest.raises(InputError) as error:
        read(text)
    message = str(error.value)
    assert "\n" not in message
    assert message.count("tiny.toml") == 1
    for part in BROKEN[text]:
        assert part in message


def test_a_study_that_is_not_there_is_told():
    with pytest.raises(InputError, match=r"study nowhere.toml cannot be read"):
        read_study(Path("nowhere.toml"))


def test_the_shipped_studies_can_be_made():
    learned, crowds = (read_study(STUDIES / f"{name}.toml") for name in ("learned", "crowds"))
    # Five seeds of ten rows, six of them under both rules, and the shipped network's validation cases.
    assert len(learned.runs) == 6 * (5 + 5 + 1) + 4 * (5 + 1)
    assert {str(run.cases) for run in learned.runs} == {"test:0:500", "val:0:1000", "val:0:200"}
    assert len(crowds.runs) == 8 * len(catalog.scenarios())
    assert {run.planner for run in crowds.runs if run.privileged} == {"sarl"}
