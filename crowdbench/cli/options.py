"""Help of options from docstrings, and options that several commands have."""

from __future__ import annotations

import copy
import inspect
import os
from collections.abc import Callable
from typing import Annotated, TypeVar, get_args, get_origin

import typer
from docstring_parser import DocstringStyle, parse

from crowdbench.utils.assignments import assignments as assignments
from crowdbench.utils.errors import InputError

ThreadsOption = Annotated[int | None, typer.Option(min=1, show_default="one per core")]
WorkersOption = Annotated[int | None, typer.Option(min=1, show_default="all of the engine, or none")]

SHARED = {
    "as_json": "Print the result as JSON instead of a table.",
    "data": "Folder with recorded tracks, which scenarios with a table [tracks] need.",
    "decision_limit": "Longest time in seconds that the planner may take for one decision of a whole batch.",
    "engine": "Cluster whose workers share the work: ray (at RAY_ADDRESS) or dask (at DASK_SCHEDULER_ADDRESS).",
    "format": "How the table is written; latex needs the package booktabs.",
    "metric": "A file with a metric of your own: ./mine.py. Repeatable.",
    "option": "An option of the planner or predictor: key=value. Repeatable. `crowdbench list planners NAME` and "
    "`list predictors NAME` show them.",
    "overrides": "Change a key of the scenario, such as vehicle.visible=true. Repeatable.",
    "overwrite": "Replace the directory of an earlier run.",
    "planner": "Name of a planner, or a file of your own: ./mine.py, ./mine.py:factory or policy.onnx.",
    "scenario": "Name of a scenario, or a file of your own: ./mine.toml.",
    "threads": "Number of threads, of each worker if there are several.",
    "workers": "Number of processes that share the work.",
}
"""Help of parameters that several commands have, by name, if the docstring of a command has none."""

FLAGS = {"as_json": "--json", "overrides": "--set"}
"""The options of parameters whose option has another name."""

Command = TypeVar("Command", bound=Callable[..., None])


def help_from_docstring(command: Command) -> Command:
    """Set the help of a command's parameters from the `Args:` of its docstring, or else from `SHARED`.

    A parameter without a default is an argument, and one with a default is an option, unless its annotation states
    otherwise. A second call changes nothing.
    """
    if hasattr(command, "__signature__"):
        return command
    description, helps = parse_docstring(command.__doc__)
    signature = inspect.signature(command, eval_str=True)
    helps = SHARED | helps
    parameters = [_with_help(item, helps.get(item.name)) for item in signature.parameters.values()]
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__doc__ = description
    return command


def parse_docstring(docstring: object) -> tuple[str, dict[str, str]]:
    """Return a docstring without its sections, and the texts of its `Args:` or `Attributes:` by name.

    A `__doc__` of a plug-in that is not a text counts as empty.
    """
    parsed = parse(docstring if isinstance(docstring, str) else "", DocstringStyle.GOOGLE)
    entries = {entry.arg_name: " ".join((entry.description or "").split()) for entry in parsed.params}
    return parsed.description or "", entries


def _with_help(parameter: inspect.Parameter, text: str | None) -> inspect.Parameter:
    if text is None:
        return parameter
    hint = parameter.annotation
    kind, infos = hint, []
    if get_origin(hint) is Annotated:
        kind, *infos = get_args(hint)
    if not infos and (kind is bool or parameter.name in FLAGS):  # Typer would add the opposite of a bool
        infos = [typer.Option(FLAGS.get(parameter.name, f"--{parameter.name.replace('_', '-')}"))]
    if not infos:
        infos = [typer.Argument() if parameter.default is parameter.empty else typer.Option()]
    info = copy.copy(infos[0])  # several commands may have it
    info.help = text
    return parameter.replace(annotation=Annotated[kind, info])


def use_threads(threads: int | None) -> None:
    """Set the number of threads of the simulator and of the networks.

    Call it before numba and torch are imported: they read the number when they are imported.

    Args:
        threads: The number, or None for one per core.

    Raises:
        InputError: The machine has fewer cores.
    """
    if threads is not None:
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        if threads > available:
            raise InputError(f"--threads {threads} is more than the {available} there are")
        os.environ |= {"NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
