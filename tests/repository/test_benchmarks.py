"""The command `python -m benchmarks`, on little work, and what the figures are made of."""

import functools
import itertools
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import crowdbench
from benchmarks import __main__ as command
from benchmarks import commands, decisions, first_runs, measurement, simulator, workers
from crowdbench import InputError


def printed(*arguments):
    result = CliRunner().invoke(command.app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def test_median_and_late_decisions_of_a_planner_are_printed(monkeypatch):
    monkeypatch.setattr(command, "CASES", "val:2")
    pattern = r"straight on circle_crossing_5: 9 decisions in one world alone take [\d.e-]+ ms \(median\), [\d.e-]+ ms"
    assert re.search(pattern, printed("--planner", "straight", "--set", "time_limit=3.0"))


def test_options_that_do_not_belong_together_are_refused():
    error = CliRunner().invoke(command.app, ["--scenario", "x"]).exception
    assert isinstance(error, InputError)
    assert "--planner" in str(error)


@pytest.mark.nightly
def test_every_measurement_is_in_the_table(monkeypatch):
    monkeypatch.setattr(simulator, "ROUNDS", 1)
    short = {
        simulator: {"steps": (), "environments": (), "scans": (20,), "fleets": (2,)},
        decisions: {"isolation": (2, 1), "sarl": (3, 1, 2), "large_crowds": (1,)},
        commands: {"start_up": ()},
    }
    taken = 0
    for module, arguments in short.items():
        for name in [name for name in vars(module) if name.startswith("measure_")]:
            taken += 1
            given = arguments.get(name.removeprefix("measure_"))
            work = list if given is None else functools.partial(getattr(module, name), *given)
            monkeypatch.setattr(module, name, work)
    assert taken == 18
    lines = printed().splitlines()
    assert sum("SARL decision, 5 pedestrians" in line for line in lines) == 2
    assert sum("environment, 6 agents, per step" in line for line in lines) == 2
    assert sum("start-up of the command line" in line for line in lines) == 1


@pytest.mark.slow
def test_a_command_is_timed_with_its_memory_and_without_that_of_its_parent():
    ballast = np.ones(60_000_000)
    usage = commands.command("--help")
    assert 0.0 < usage.seconds < 60.0
    assert 0.0 < usage.processor < 60.0
    assert 1e7 < usage.memory < ballast.nbytes


@pytest.mark.slow
def test_a_command_that_fails_is_no_measurement(tmp_path):
    with pytest.raises(InputError, match=r"run --planner nobody.*no planner is called 'nobody'"):
        commands.command("run", "--planner", "nobody", "--out", str(tmp_path / "run"))


COMPILES = """python -c "
import numpy as np
import crowdbench
from crowdbench.sim.kernels import at
at(np.ones((1, 1)), 0, 0)
open('runs', 'a').write(crowdbench.__file__ + ' ')
" """


@pytest.mark.slow
def test_a_command_compiles_in_the_first_of_two_clones_only(tmp_path):
    for name in ("first", "second"):
        shutil.copytree(Path(crowdbench.__file__).parent, tmp_path / name / "crowdbench")
    ended = []
    rows = list(first_runs.measure(COMPILES, 1, tmp_path, ended.append))
    assert [row[1] for row in rows] == ["empty cache", "filled cache", "second clone, filled cache"]
    assert [row[4] for row in rows] == ["1", "0", "0"]
    assert ended == [1] * 3
    for name, runs in (("first", 2), ("second", 1)):
        package = tmp_path / name / "crowdbench" / "__init__.py"
        assert (tmp_path / name / "runs").read_text() == f"{package} " * runs


def test_works_that_are_compared_take_turns():
    order = []
    times = itertools.count()

    def work(name):
        order.append(name)
        return float(next(times))

    ours, theirs = measurement.in_turns(3, lambda: work("ours"), lambda: work("theirs"))
    assert order == ["ours", "theirs"] * 4
    assert (ours, theirs) == (4.0, 5.0)


@pytest.mark.nightly
def test_workers_are_compared_with_one_process(capsys):
    workers.workers("straight", cases=4)
    table = capsys.readouterr().out.splitlines()
    assert [line.split()[-2:] for line in table if line.startswith("one process")] == [["yes", "1.00"]]
    assert sum(" yes " in line for line in table) == 4
