"""`.ci/size`: no part of the repository has more lines of code than `pyproject.toml` allows."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / ".ci" / "size"

THREE_LINES = '''"""A docstring,
of two lines."""

import os  # an import


def f():  # a comment
    """Another docstring."""
    return """two
lines"""
'''


@pytest.mark.parametrize(
    ("sizes", "sentence"),
    [
        ('"a, b" = 3\n"*.css" = 2\n"files of a" = 1', ""),
        ('"a, b" = 2', "a, b has 3, above the limit of 2: see [tool.crowdbench.size] of pyproject.toml\n"),
        ('"*.css" = 1', "*.css has 2, above the limit of 1: see [tool.crowdbench.size] of pyproject.toml\n"),
        ('"files of a" = 0', "files of a has 1, above the limit of 0: see [tool.crowdbench.size] of pyproject.toml\n"),
        ("c = 3", "c has no file: correct [tool.crowdbench.size] of pyproject.toml\n"),
    ],
)
def test_a_part_above_its_number_fails(tmp_path, sizes, sentence):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "code.py").write_text(THREE_LINES)
    (tmp_path / "style.css").write_text("a {\n}\n")
    (tmp_path / "pyproject.toml").write_text(f"[tool.crowdbench.size]\n{sizes}\n")
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)
    done = subprocess.run([sys.executable, SCRIPT], cwd=tmp_path, capture_output=True, text=True)
    assert done.stderr == sentence
    assert done.returncode == bool(sentence)
