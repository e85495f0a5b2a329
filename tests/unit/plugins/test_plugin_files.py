import hashlib
import importlib.metadata
import sys
from pathlib import Path

import pytest

from crowdbench import catalog
from crowdbench.plugins.kind import load_module
from crowdbench.plugins.plugin_files import PluginFiles, read_files
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
    files = read_files(folder / "mine.py").digests
    inner = ["tools/geometry/__init__.py", "tools/geometry/inner.py", "tools/shared.py"]
    assert list(files) == ["deeper.py", "helper.py", "lazy.py", "mine.py", *inner]
    assert files["lazy.py"] == hashlib.sha256(b"LATER = 1").hexdigest()


@pytest.mark.parametrize("name", ["mine.py", "helper.py", "deeper.py", "lazy.py", "tools/geometry/inner.py"])
def test_a_changed_helper_changes_the_source(folder, name):
    before = read_files(Path("mine.py")).digest
    (folder / name).write_text((folder / name).read_text() + "\n# changed\n")
    assert read_files(Path("mine.py")).digest != before


def test_other_files_of_the_folder_do_not_change_the_source(folder):
    before = read_files(Path("mine.py")).digest
    (folder / "other.py").write_text("changed")
    (folder / "tools" / "unused.py").write_text("changed")
    assert read_files(Path("mine.py")).digest == before


def test_the_source_of_a_file_that_imports_nothing_is_its_own_digest(folder):
    assert read_files(Path("lazy.py")).digest == hashlib.sha256(b"LATER = 1").hexdigest()[:12]
    assert catalog.PLANNERS.load_with_digest("orca")[2] is None
    one, two = "1" * 64, "2" * 64
    assert PluginFiles({"a": one, "b": two}, set()).digest != PluginFiles({"a": two, "b": one}, set()).digest


def test_a_broken_helper_counts_and_one_that_cannot_be_read_is_told(folder):
    (folder / "mine.py").write_text("def planner():\n    import other, gone\n")
    assert list(read_files(folder / "mine.py").digests) == ["mine.py", "other.py"]
    with pytest.raises(InputError, match=r"nowhere\.py"):
        load_module(folder / "nowhere.py")


def test_crowdbench_is_no_part_of_a_planner_beside_it(folder):
    (folder / "crowdbench").mkdir()
    (folder / "crowdbench" / "__init__.py").touch()
    (folder / "mine.py").write_text("from crowdbench import Planner\nimport numpy\n")
    assert list(read_files(folder / "mine.py").digests) == ["mine.py"]


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
    (folder / "lab" / "__init__.py").write_text("import helper")
    (folder / "lab" / "drivers.py").write_text("from . import parts\nimport lab.more, helper")
    (folder / "lab" / "parts.py").touch()
    (folder / "lab" / "more.py").touch()
    monkeypatch.syspath_prepend(folder)
    entry = importlib.metadata.EntryPoint("lab", "lab.drivers:planner", catalog.PLANNERS.entry_points)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    assert list(catalog.PLANNERS.files("lab").digests) == [
        "lab/__init__.py",
        "lab/drivers.py",
        "lab/more.py",
        "lab/parts.py",
    ]
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lab", "helper", "deeper")]:
        monkeypatch.delitem(sys.modules, name)
