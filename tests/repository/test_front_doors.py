"""Code outside of the package imports the public names of the package, which `__init__.pyi` of each folder lists."""

import ast
import collections
import importlib
import inspect
import re
from pathlib import Path

import pytest

from crowdbench.catalog import PEDESTRIANS, PLANNERS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "crowdbench"
OUTSIDE = ("agents", "adapters", "studies", "benchmarks", "examples", "leaderboards/crowdbench_leaderboards")
STUBS = sorted([PACKAGE / "__init__.pyi", *PACKAGE.glob("*/__init__.pyi")])


def door_of(stub):
    return ".".join(stub.relative_to(ROOT).parent.parts)


def names_of(stub):
    imports = [node for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ImportFrom)]
    return [(node.module, alias.name) for node in imports for alias in node.names]


DOORS = {door_of(stub): {name for _, name in names_of(stub)} for stub in STUBS}


def private_imports(path):
    """Yield the imports of a file from crowdbench that are no public names."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names if alias.name.startswith("crowdbench.")]
            yield from (f"{path.relative_to(ROOT)}:{node.lineno} imports {module}" for module in modules)
        elif isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "crowdbench":
            hidden = [alias.name for alias in node.names if alias.name not in DOORS.get(node.module, ())]
            yield from (f"{path.relative_to(ROOT)}:{node.lineno} imports {node.module}.{name}" for name in hidden)


@pytest.mark.parametrize("folder", OUTSIDE)
def test_code_outside_of_the_package_imports_public_names_only(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    assert [line for path in files for line in private_imports(path)] == []


def test_the_api_page_lists_each_public_name_once():
    listed = collections.defaultdict(list)
    for door, names in re.findall(r"^\| `([\w.]+)` \| (.*) \|$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE):
        listed[door] += re.findall(r"`(\w+)`", names)
    assert {door: sorted(names) for door, names in listed.items()} == {
        door: sorted(names) for door, names in DOORS.items()
    }


@pytest.mark.parametrize("stub", STUBS, ids=door_of)
def test_public_names_exist_and_none_is_a_module(stub):
    names = [name for _, name in names_of(stub)]
    modules = {path.stem for path in stub.parent.glob("*.py")} | {
        path.parent.name for path in stub.parent.glob("*/*.py")
    }
    assert modules.intersection(names) == set()
    door = importlib.import_module(door_of(stub))
    assert door.__all__ == sorted(set(names))
    for name in door.__all__:
        public = getattr(door, name)
        is_ours = inspect.isclass(public) and public.__module__.startswith("crowdbench")
        assert public.__doc__ or not (is_ours or inspect.isfunction(public)), f"{name} has no docstring"


@pytest.mark.parametrize("kind", [PLANNERS, PEDESTRIANS], ids=["planners", "pedestrians"])
def test_what_agents_holds_is_importable_as_a_package_too(kind):
    for path in kind.built_in().values():
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        assert callable(getattr(importlib.import_module(module), kind.function))
