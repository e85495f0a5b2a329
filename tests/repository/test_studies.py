"""The scripts of studies/ start, and their files are in order; what each measures has tests of its own."""

import ast
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
SPECS = {
    "dials": DialStudy,
    "ladder": LadderStudy,
    "li2020": ReproductionSpec,
    "published": PublishedSpec,
    "reactions": ReactionsSpec,
    "transfer": TransferStudy,
}


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_starts_in_any_folder(script, tmp_path):
    command = [sys.executable, ROOT / script, "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "Usage" in done.stdout


@pytest.mark.parametrize("name", ["suite", "learned", "policies", "crowds", "kce", "recorded", "crowdnav_plus"])
def test_the_tables_of_a_study_are_in_order(name):
    file = ROOT / "studies" / name / "study.toml"
    assert parse_table(StudySpec, tomllib.loads(file.read_text()), Location(name)).description


@pytest.mark.parametrize("name", SPECS)
def test_the_file_of_a_study_is_in_order(name):
    assert read_file(ROOT / "studies" / name / "study.toml", SPECS[name]).description


def test_nothing_in_the_package_imports_the_studies():
    for path in ROOT.glob("crowdbench/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.partition(".")[0] == "studies"], path
