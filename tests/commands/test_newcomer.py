"""Ten jobs of a researcher who is new to crowdbench, each by the commands that `--help` names."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import crowdbench
from crowdbench.core.types import Outcome
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.record import viewer
from crowdbench.record.recorded_cases import recorded_outcomes
from crowdbench.results.episodes import Episodes

ROOT = Path(__file__).parents[2]

CAUTIOUS = """
import numpy as np
from crowdbench import Planner

class Cautious(Planner):
    def plan(self, obs):
        way = obs.vehicle.local_goal - obs.vehicle.position
        gap = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2).min(axis=1)
        return np.where(gap < 1.5, SLOW, 1.0)[:, None] * way / np.linalg.norm(way, axis=1)[:, None]

def planner():
    return Cautious()
"""

COLUMN = r"""
\documentclass[twocolumn]{article}
\usepackage{booktabs}
\setlength{\textwidth}{516pt}\setlength{\columnsep}{12pt}
\hfuzz=0pt
\begin{document}\typeout{a column has \the\columnwidth}\noindent\input{table.tex}\end{document}
"""
"""A page with columns as wide as those of IEEE's conferences: 252 pt."""


class Straight(torch.nn.Module):
    """Drives to the goal; with a memory, faster in each step."""

    def forward(self, observed, *speed):
        still = 0.0 * observed[:, :1]
        if not speed:
            return torch.cat([still + 0.8, still], 1)
        return torch.cat([speed[0] + 0.05, still], 1), speed[0] + 0.05


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def done(call):
    """Run a command that must succeed, and return what it prints."""

    def run(*arguments):
        finished = call(*arguments)
        assert finished.returncode == 0, finished.stderr
        return finished.stdout

    return run


def export(file, state=()):
    pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")
    pytest.importorskip("onnxscript", reason="torch's exporter is not installed: pip install 'crowdbench[onnx]'")
    crowdbench.export_policy(
        Straight(), file, VehicleEnv(observation="goal_frame", action="goal_frame", nearest=3), state=state
    )


@pytest.mark.slow
def test_an_onnx_file_is_driven(done):
    export("policy.onnx")
    shown = done("run", "--planner", "policy.onnx", "--cases", "val:6")
    assert shown.startswith("policy on circle_crossing_5, cases val:0:6\n")
    assert re.search(r"^success +[\d.]+ % .* 6$", shown, re.MULTILINE)
    assert "Kept in runs/policy-circle_crossing_5-val-6; " in shown


@pytest.mark.slow
def test_a_recurrent_policy_is_driven_alone_as_in_a_batch(done):
    export("policy.onnx", state=[(1,)])
    for cases in ("val:6", "val/4"):
        done("run", "--planner", "policy.onnx", "--cases", cases, "--record", "none", "--out", cases.replace("/", "-"))
    batch, alone = (Episodes.read(Path(name) / "episodes.csv") for name in ("val:6", "val-4"))
    assert (alone.outcome[0], alone.steps[0]) == (batch.outcome[4], batch.steps[4])
    assert alone.columns["max_velocity_change"][0] == pytest.approx(0.05, abs=1e-5)


def test_a_function_is_driven(done):
    forward = crowdbench.PolicyPlanner(
        lambda seen: np.tile([0.8, 0.0], (len(seen), 1)), observation="goal_frame", action="goal_frame"
    )
    found = crowdbench.run(forward, cases="val:6", out="forward")
    shown = done("table", "forward", "--metric", "success_rate")
    success = found.metrics["success_rate"]
    assert f"| PolicyPlanner | {100 * success.mean:.1f} ({100 * success.low:.1f} to " in shown
    assert shown.endswith("\n\nCases val:0:6, n = 6.\n")


@pytest.mark.nightly
def test_a_policy_of_stable_baselines3_is_trained_and_exported(done):
    export("policy.onnx")  # which skips where packages are missing
    pytest.importorskip("stable_baselines3", reason="pip install 'crowdbench[ppo]'")
    command = [sys.executable, ROOT / "examples" / "ppo_stable_baselines3.py", "--steps", "150000", "--out", "ppo.onnx"]
    made = subprocess.run(
        command, check=True, capture_output=True, text=True, env=os.environ | {"NUMBA_NUM_THREADS": "1"}
    )
    success = re.search(r"^ppo\.onnx: ([\d.]+) % success on validation cases$", made.stdout, re.MULTILINE)
    assert float(success[1]) > 10.0
    assert "cases val:0:4" in done("run", "--planner", "ppo.onnx", "--cases", "val:4")


def test_two_versions_of_a_planner_are_compared(call, done):
    for version, slow in (("old", "0.3"), ("new", "0.6")):
        Path("mine.py").write_text(CAUTIOUS.replace("SLOW", slow))
        if version == "new":
            refused = call("run", "--planner", "./mine.py", "--cases", "val:12", "--out", "old")
            assert "old exists already" in refused.stderr
            assert "mine.py was edited since that run" in refused.stderr
        done("run", "--planner", "./mine.py", "--cases", "val:12", "--out", version)
    rows = done("table", "old", "new").splitlines()
    assert [row.split(" | ")[0] for row in rows[2:4]] == ["| old", "| new"]
    assert "| 0.3 |" in done("table", "old", "new", "--names", "0.3,0.6", "--metric", "jerk").replace(" (", " |")
    assert done("compare", "old", "new").startswith("old and new: 12 shared cases (val:0:12), ")


def test_a_table_of_different_cases_is_refused(call, done):
    for scenario, cases in (("circle_crossing_5", "val:6"), ("square_crossing_5", "5")):
        done("run", "--planner", "straight", "--scenario", scenario, "--cases", cases, "--record", "none")
    for more in ([], ["--columns", "scenario"]):
        refused = call("table", *map(str, Path("runs").iterdir()), *more)
        assert refused.returncode == 1
        assert "make all runs with the same cases" in refused.stderr
        assert {"val:0:6", "test:0:5"} <= set(re.findall(r"\w+:\d+:\d+", refused.stderr))
    assert "runs is not the directory of a run" in (said := call("table", "runs").stderr)
    assert "give those in it: runs/*" in said


@pytest.fixture
def driven(done):
    """A run in which most cases are not recorded."""
    done("run", "--planner", "orca_margin", "--cases", "val:40", "--out", "run")
    return Episodes.read(Path("run/episodes.csv"))


def test_the_first_failure_is_played_on_this_machine_alone(done, driven, monkeypatch):
    played = []
    monkeypatch.setattr(viewer, "show", lambda file, *, web: played.append(recorded_outcomes(file)))
    outcomes = done("view", "run").splitlines()
    ((case,),) = played
    assert case == driven.case[driven.outcome == Outcome.COLLISION][0]
    assert [line.split(" (")[0].split(" ")[1] for line in outcomes[:-1]] == ["collisions", "timeout", "successes"]
    assert outcomes[-1] == f"case val/{case}"
    command = viewer._command(Path("run.rrd"), 9876, [])
    assert command[command.index("--bind") + 1] == "127.0.0.1"


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_a_table_in_latex_fits_a_column(done):
    for planner in ("orca", "orca_margin", "social_force"):
        done("run", "--planner", planner, "--cases", "val:40", "--record", "none")
    runs = sorted(map(str, Path("runs").iterdir()))
    for name, more in {
        "long": ["--names", "sarl_sgan_kce,orca,ppo_attention"],
        "marked": ["--columns", "scenario"],
    }.items():
        Path("table.tex").write_text(done("table", *runs, "--format", "latex", *more))
        Path(f"{name}.tex").write_text(COLUMN)
        log = subprocess.run(["pdflatex", "-halt-on-error", f"{name}.tex"], capture_output=True, text=True)
        assert log.returncode == 0, log.stdout
        assert "a column has 252.0pt" in log.stdout
        assert "Overfull" not in log.stdout
