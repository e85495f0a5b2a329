"""The scripts of studies/ start, and their files are in order; what each measures has tests of its own."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from crowdbench.utils.toml import Location, parse_table
from studies.dials.table import DialStudy
from studies.ladder.table import LadderStudy
from studies.li2020.table import ReproductionSpec
from studies.pages import read_file
from studies.published.table import PublishedSpec
from studies.reactions.run import ReactionsSpec
from studies.tables import StudySpec
from studies.transfer.table import TransferStudy

ROOT = Path(__file__).parents[2]
RUNNABLE = (path for path in ROOT.glob("studies/**/*.py") if "__main__" in path.read_text())
SCRIPTS = sorted(path.relative_to(ROOT).as_posix() for path in RUNNABLE)
HELP = """
import contextlib, os, runpy, sys
path = list(sys.path)
for script in sys.argv[1:]:
    sys.argv, sys.path[:] = [script, "--help"], [os.path.dirname(script), *path[1:]]
    with contextlib.suppress(SystemExit):
        runpy.run_path(script, run_name="__main__")
"""
"""Starts each script as Python does, but in one process: each imports the same packages."""

SPECS = {
    "dials": DialStudy,
    "ladder": LadderStudy,
    "li2020": ReproductionSpec,
    "published": PublishedSpec,
    "reactions": ReactionsSpec,
    "transfer": TransferStudy,
}


@pytest.mark.slow
def test_the_scripts_start_in_any_folder(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", HELP, *(str(ROOT / script) for script in SCRIPTS)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.count("Usage") == len(SCRIPTS)


@pytest.mark.parametrize("name", ["success", "learned", "policies", "crowds", "kce", "recorded", "crowdnav_plus"])
def test_the_tables_of_a_study_are_in_order(name):
    file = ROOT / "studies" / name / "study.toml"
    assert parse_table(StudySpec, tomllib.loads(file.read_text()), Location(name)).description


@pytest.mark.parametrize("name", SPECS)
def test_the_file_of_a_study_is_in_order(name):
    assert read_file(ROOT / "studies" / name / "study.toml", SPECS[name]).description
