"""The examples of reinforcement learning: plain code of at most 60 lines that learns, with public names alone."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
LONGEST = 60


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    ["ppo_single_file.py --updates 10", pytest.param("ippo.py --steps 60000", marks=pytest.mark.nightly)],
)
def test_an_example_learns_within_seconds(command, tmp_path):
    """A policy that has not learned stands still, and succeeds in no case."""
    file, *arguments = command.split()
    run = subprocess.run(
        [sys.executable, EXAMPLES / file, *arguments, "--out", "policy.onnx"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"NUMBA_NUM_THREADS": "1"},
    )
    assert run.returncode == 0, run.stderr
    success = re.fullmatch(r"policy\.onnx: ([\d.]+) % success on validation cases", run.stdout.splitlines()[-1])
    assert float(success[1]) > 10.0
    assert list(tmp_path.glob("policy.onnx"))


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*ppo*.py")), ids=lambda file: file.stem)
def test_an_example_of_reinforcement_learning_is_short(file):
    assert len(file.read_text().splitlines()) <= LONGEST
