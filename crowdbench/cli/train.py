"""The command that trains networks. The dataclasses of the methods declare most of its options."""

from __future__ import annotations

import contextlib
import inspect
import shlex
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_origin, get_type_hints

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import ThreadsOption, assignments, help_from_docstring, parse_docstring, use_threads
from crowdbench.train.config import METHODS, Config, flag, make_config, networks_by_option
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.train.runner import Runner

PERIOD = 1.0
"""Seconds between two reports of the progress of a training."""


@help_from_docstring  # before the options of the methods are added
def train(
    network: Annotated[str, typer.Argument(help=f"One of {', '.join(METHODS)}.")],
    device: str = "cpu",
    threads: ThreadsOption = None,
    resume: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="runs/train-<network>-seed<seed>")] = None,
    **options: Any,
) -> None:
    """Train a value network or a policy for planners.

    A value network first imitates demonstrations by ORCA, then learns from its own episodes. In validation, the
    lookahead always predicts constant velocity. Of the checkpoints whose success on validation cases is within noise of
    the best, the one with the shortest time to the goal is kept.

    Args:
        device: cpu or cuda.
        resume: Continue the interrupted training in this directory, with the options and the number of threads that it
            was started with; only --device and --threads can be different.
        out: Directory for the results.
    """
    run_training(network, options, device, threads, resume, out)


def run_training(
    network: str,
    options: Mapping[str, Any],
    device: str,
    threads: int | None,
    resume: Path | None,
    out: Path | None,
    methods: Mapping[str, type[Config]] = METHODS,
) -> None:
    """Start or resume a training, train to the end with progress, and print the path of the weights.

    Args:
        network: The name of the network.
        options: The options of the command line, by field name; None for those that are not given.
        device: `cpu` or `cuda`.
        threads: The number of threads; None for one per core.
        resume: The directory of an interrupted training, or None.
        out: The directory for the results; None for one in runs/.
        methods: The options of the methods, by the name of the network.

    Raises:
        InputError: An option is impossible, or a file cannot be read or written.
    """
    use_threads(threads)
    from crowdbench.train.runner import Finished, Runner

    given = {name: value for name, value in options.items() if value is not None}
    if resume is None:
        pairs = {name: assignments(value, flag(name)) for name, value in given.items() if isinstance(value, list)}
        config = make_config(network, given | pairs, methods)
        announce_compilation()
        runner = Runner.start(config, out or Path("runs") / f"train-{network}-seed{config.seed}", device)
    else:
        if flags := [flag(name) for name in [*given, *(["out"] if out else [])]]:
            raise InputError(
                f"{', '.join(flags)} cannot be changed with --resume: a training goes on with the options that it was "
                "started with, except --device and --threads"
            )
        announce_compilation()
        try:
            runner = Runner.resume(resume, device, threads, methods)
        except Finished as finished:
            say(f"crowdbench: {finished}")
            return
        if runner.training.config.network != network:
            raise InputError(f"the training in {resume} is of {runner.training.config.network}, not of {network}")
    _run(runner)


def _run(runner: Runner) -> None:
    """Train to the end with progress, and print the path of the weights."""
    training = runner.training
    with exit_on_interrupt(f"continue with {training.config.program} --resume {shlex.quote(str(runner.directory))}"):
        with progress(1.0, "trained") as advance, _follow(lambda: training.progress, advance):
            for point in runner.train():
                say(training.describe(point))
        cases = sum(map(len, training.card_cases.values()))
        with progress(cases, f"of {cases} cases for the card") as advance:
            weights = runner.finish(advance)
    kept = " ".join(training.describe(training.best()[0]).split())
    print(f"The network of one validation was kept, the quickest within the noise of the best success: {kept}")
    print(f"Its card has figures on other cases: {weights.with_suffix('.md')}")
    option = shlex.quote(f"weights={weights}")
    print(f"The weights are in {weights}; use them with crowdbench {training.config.usage} --option {option}")


@contextlib.contextmanager
def _follow(read: Callable[[], float], advance: Callable[[float], None]) -> Iterator[None]:
    """Report a progress every second, also between two validations, which may take minutes.

    Args:
        read: Returns the progress.
        advance: Called with its growth.
    """
    shown, ended = 0.0, threading.Event()

    def report() -> None:
        nonlocal shown
        now = read()
        advance(now - shown)
        shown = now

    def follow() -> None:
        report()
        while not ended.wait(PERIOD):
            report()

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        report()


def with_method_options(
    signature: inspect.Signature, methods: Mapping[str, type[Config]] = METHODS
) -> inspect.Signature:
    """Return a signature with the options of the training methods instead of its last parameter, `**options`.

    An option is None if it is not given. The field gives its type and its default, the docstring its help.
    """
    *common, _ = signature.parameters.values()
    parameters = []
    for name, networks in networks_by_option(methods).items():
        config = methods[networks[0]]
        default = getattr(config, name, None)
        hint: Any = get_type_hints(config)[name]
        option = typer.Option(
            flag(name),
            help=_read_help(config)[name],
            show_default=False if default in (None, False) else str(default),
            rich_help_panel=f"Options for {', '.join(networks)} only" if len(networks) < len(methods) else None,
        )
        kind: Any = list[str] if get_origin(hint) is Mapping else hint
        hint = Annotated[kind | None, option]
        parameters.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=hint))
    return signature.replace(parameters=[*common, *parameters])


def _read_help(config: type[Config]) -> dict[str, str]:
    """Return the texts of the attributes in the docstrings of a dataclass and its base classes, by name."""
    texts: dict[str, str] = {}
    for base in reversed(config.__mro__):
        texts |= parse_docstring(base.__doc__)[1]
    return texts


# Typer reads the options from the signature.
train.__signature__ = with_method_options(inspect.signature(train))  # type: ignore[attr-defined]
