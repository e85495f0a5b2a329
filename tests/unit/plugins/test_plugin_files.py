import hashlib
import importlib.metadata
import sys
from pathlib import Path

import pytest

from crowdbench import catalog
from crowdbench.plugins.kind import load_module
from crowdbench.plugins.plugin_files import read_files, short_digest
from crowdbench.utils.errors import InputError

MINE = """
import json
import helper, nowhere
from crowdbench.planners.reactive import ORCAPlanner
from tools import geometry

def planner(margin=0.0):
    from lazy import LATER
    return ORCAPlanner(margin)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder to be in, with a planner whose helpers stand beside it."""
    monkeypatch.chdir(tmp_path)
    files = {
        "mine.py": MINE.replace("helper, nowhere", "helper"),
        "helper.py": "import deeper",
        "deeper.py": "import helper",
        "lazy.py": "LATER = 1",
        "other.py": "this is no Python",
        "tools/geometry/__init__.py": "from .inner import norm\nfrom .. import shared",
        "tools/geometry/inner.py": "norm = 1",
        "tools/shared.py": "",
        "tools/unused.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_what_a_file_imports_from_its_folder_counts_wherever_the_import_stands(folder):
    files = read_files(folder / "mine.py")
    inner = [f"tools/{name}.py" for name in ("geometry/__init__", "geometry/inner", "shared", "unused")]
    assert list(files) == ["deeper.py", "helper.py", "lazy.py", "mine.py", *inner]
    assert files["lazy.py"] == hashlib.sha256(b"LATER = 1").hexdigest()


@pytest.mark.parametrize("name", ["mine.py", "helper.py", "deeper.py", "lazy.py", "tools/unused.py"])
def test_a_changed_helper_changes_the_source(folder, name):
    before = short_digest(read_files(Path("mine.py")))
    (folder / name).write_text((folder / name).read_text() + "\n# changed\n")
    assert short_digest(read_files(Path("mine.py"))) != before


def test_other_files_of_the_folder_do_not_change_the_source(folder):
    before = short_digest(read_files(Path("mine.py")))
    (folder / "other.py").write_text("changed")
    assert short_digest(read_files(Path("mine.py"))) == before


def test_the_source_of_a_file_that_imports_nothing_is_its_own_digest(folder):
    assert short_digest(read_files(Path("lazy.py"))) == hashlib.sha256(b"LATER = 1").hexdigest()[:12]
    assert catalog.PLANNERS.load_with_digest("orca")[2] is None
    assert short_digest({"a": "1" * 64, "b": "2" * 64}) != short_digest({"a": "2" * 64, "b": "1" * 64})


def test_a_broken_helper_counts_and_one_that_cannot_be_read_is_told(folder):
    (folder / "mine.py").write_text("def planner():\n    import other, gone\n")
    assert list(read_files(folder / "mine.py")) == ["mine.py", "other.py"]
    with pytest.raises(InputError, match=r"nowhere\.py"):
        load_module(folder / "nowhere.py")


def test_crowdbench_is_no_part_of_a_planner_beside_it(folder):
    (folder / "crowdbench").mkdir()
    (folder / "crowdbench" / "__init__.py").touch()
    (folder / "mine.py").write_text("from crowdbench import Planner\nimport numpy\n")
    assert list(read_files(folder / "mine.py")) == ["mine.py"]


def test_files_that_options_name_count_with_what_belongs_to_them(folder):
    (folder / "net.safetensors").write_text("weights")
    (folder / "net.json").write_text("card")
    options = {
        "weights": "net.safetensors",
        "predictor": "./helper.py",
        "limits": {"table": ["lazy.py"]},
        "network": "sarl-seed2",
        "modes": 5,
        "word": "mean",
        "long": "x" * 5000,
        "odd": "\0",
        "empty": "",
    }
    found = catalog.planner_files("orca", options)
    assert {name: list(files) for name, files in found.items()} == {
        "planner": ["orca.py"],
        "option weights": ["net.safetensors", "net.json"],
        "option predictor": ["deeper.py", "helper.py"],
        "option limits": ["lazy.py"],
        "option network": ["sarl-seed2.safetensors", "sarl-seed2.json"],
    }
    assert found["option weights"]["net.json"] == hashlib.sha256(b"card").hexdigest()


def test_an_installed_planner_consists_of_the_files_of_its_package(folder, monkeypatch):
    (folder / "lab").mkdir()
    for name in ("__init__", "drivers", "unused"):
        (folder / "lab" / f"{name}.py").write_text("raise RuntimeError")
    monkeypatch.syspath_prepend(folder)
    entries = {
        name: importlib.metadata.EntryPoint(name, f"{module}:planner", catalog.PLANNERS.entry_points)
        for name, module in {"lab": "lab.drivers", "alone": "lazy", "gone": "gone.away"}.items()
    }
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries.values())
    assert list(catalog.PLANNERS.files("lab")) == ["lab/__init__.py", "lab/drivers.py", "lab/unused.py"]
    assert list(catalog.PLANNERS.files("alone")) == ["lazy.py"]
    assert not catalog.PLANNERS.files("gone")
    assert not {"lab", "lazy"} & sys.modules.keys(), "no file is executed"


def test_every_file_of_the_shipped_planners_counts_for_one():
    folder = catalog.ROOT / "agents" / "planners"
    known = {path.name for name in catalog.PLANNERS.built_in() for path in map(Path, catalog.PLANNERS.files(name))}
    assert {path.name for path in folder.rglob("*.py")} - {"__init__.py"} == known
