"""The identity of a run: everything that its results depend on. docs/identity.md lists the effects of edits."""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import linecache
import secrets
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from crowdbench.metrics.registry import METRICS
from crowdbench.plugins.kind import PACKAGE, ROOT
from crowdbench.plugins.plugin_files import read_files
from crowdbench.results.result_file import digest_of
from crowdbench.sim.version import SIMULATOR
from crowdbench.utils.files import sha256

REACHED = (
    "__init__.pyi",
    "agents/pedestrians",
    "catalog.py",
    "core",
    "networks",
    "planners",
    "plugins",
    "predict",
    "runs/rollout.py",
    "runs/spec.py",
    "scenario",
    "sim",
    "utils",
    "views",
)
"""The files and folders that a rollout can reach, apart from the files of its planner."""

_SUFFIXES = (".py", ".pyi", ".safetensors")

UNKNOWN = "unknown-"
"""Prefix of keys of `new_key`."""


def code() -> str:
    """Return the digest of the code that a rollout can reach."""
    return source_digest(*REACHED)


@functools.cache
def source_digest(*names: str) -> str:
    """Return the sha256 of paths and contents of files of the package and of its agents.

    Args:
        names: Files, or folders with all files of Python and of weights in them.
    """
    total = hashlib.sha256()
    for name in names:
        start = (ROOT if name.startswith("agents/") else PACKAGE) / name
        for path in [start] if start.is_file() else sorted(start.rglob("*")):
            if path.suffix in _SUFFIXES:
                relative = path.relative_to(start).as_posix()
                total.update(f"{name} {relative} {sha256(path)}\n".encode())
    return total.hexdigest()


@dataclass(frozen=True)
class PlannerId:
    """Facts that determine the commands of a planner, apart from the simulator.

    Attributes:
        name: The planner's name.
        options: Its options.
        files: The sha256 of the files of the planner and of its options, by path. See `catalog.planner_files`.
        facts: The planner's attribute `facts`, such as the digest of its weights.
        key: For planner objects that a user constructs: the author's name for this version, or a random key if there is
            none.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    key: str = ""

    @property
    def is_resumable(self) -> bool:
        """True if another process can construct the same planner."""
        return not self.key.startswith(UNKNOWN)


@dataclass(frozen=True)
class RunId:
    """The identity and only hash of a run. Other facts (time, versions, isolation, ...) are only stated in a result.

    Attributes:
        planner: Identity of the planner.
        scenario: The digest of the scenario's contents, see `scenario.digest`.
        cases: The cases.
        replanning: When the planner observes, see `Replanning.settings`.
        batch: Number of cases in lock-step if it changes the last bits of the planner's values; None otherwise.
        metrics: The digest of the source of each metric, by name.
        decision_limit: Seconds that the planner may take for a decision.
        code: The digest of the code that a rollout can reach, see `REACHED`.
        simulator: Version of the simulator, see `SIMULATOR`.
        others: Identity of the planner of the other vehicles; None if there is none.
    """

    planner: PlannerId
    scenario: str
    cases: str
    replanning: Mapping[str, int]
    batch: int | None
    metrics: Mapping[str, str]
    decision_limit: float
    code: str
    simulator: int = SIMULATOR
    others: PlannerId | None = None

    @property
    def parts(self) -> dict[str, Any]:
        """All fields, as in `result.json`, which has `others` only if there are any."""
        return {name: value for name, value in asdict(self).items() if name != "others" or value}

    @property
    def digest(self) -> str:
        """The digest of all parts, with 64 hexadecimal digits."""
        return digest_of(self.parts)


def new_key() -> str:
    """Return a unique key for planner objects whose author gives none, so that no run is resumed with them."""
    return f"{UNKNOWN}{secrets.token_hex(8)}"


def without_random_key(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of an identity with the same key for all objects whose author gives none, and no user metrics.

    The parts are unchanged if there is a key.
    """
    planner = parts["planner"]
    if not planner["key"].startswith(UNKNOWN):
        return dict(parts)
    metrics = {name: digest for name, digest in parts["metrics"].items() if name in METRICS}
    return {**parts, "planner": {**planner, "key": UNKNOWN}, "metrics": metrics}


def source_of(thing: type | Callable[..., Any]) -> str:
    """Return 16 hexadecimal digits that change with the source of a class or a function.

    In crowdbench they cover all files of its folder, such as `metrics`. In a user's file they cover that file and those
    that it imports, see `plugins.read_files`. For code typed into an interpreter, they cover its text if it is
    available; otherwise the digits are random.
    """
    module = str(getattr(thing, "__module__", ""))
    file = Path(getattr(sys.modules.get(module), "__file__", None) or "")
    if module.startswith("crowdbench."):
        return source_digest(file.relative_to(PACKAGE).parts[0])[:16]
    if file.is_file():  # not `<stdin>`
        return digest_of({"files": read_files(file)})[:16]
    try:
        source = inspect.getsource(thing)
    except (OSError, TypeError):
        if not isinstance(thing, type):  # an object that can be called
            return source_of(type(thing))
        source = _class_in_cell(thing) or secrets.token_hex(8)
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def _class_in_cell(kind: type) -> str | None:
    """Return the source of a class of a notebook cell: `inspect.getsource` finds only its functions before 3.13."""
    for function in filter(inspect.isfunction, vars(kind).values()):
        cell = "".join(linecache.getlines(function.__code__.co_filename))
        for node in ast.walk(ast.parse(cell)):
            if isinstance(node, ast.ClassDef) and node.name == kind.__name__:
                return ast.get_source_segment(cell, node)
    return None


def id_of_object(planner: object, name: str, facts: Mapping[str, str], key: str) -> PlannerId:
    """Return the identity of a planner object that a user constructed: the sources of its classes, and a key.

    Args:
        planner: The planner.
        name: Its name in tables.
        facts: The planner's attribute `facts`.
        key: The user's name for its version, or a random key.
    """
    classes = [
        kind for kind in type(planner).__mro__ if kind.__module__.partition(".")[0] not in sys.stdlib_module_names
    ]
    sources = {f"{kind.__module__}.{kind.__qualname__}": source_of(kind) for kind in classes}
    return PlannerId(name, files={"classes": sources}, facts=facts, key=key)
