"""The command that trains networks."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import ThreadsOption, assignments, help_from_docstring, use_threads
from crowdbench.train.config import METHODS, MOST_SEED, SCENARIO, Config, flag, make_config, method_options
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.train.runner import Runner


@help_from_docstring  # before the options of the methods are added
def train(
    network: Annotated[str, typer.Argument(help=f"One of {', '.join(METHODS)}.")],
    scenario: Annotated[str | None, typer.Option(show_default=SCENARIO)] = None,
    overrides: list[str] | None = None,
    data: Path | None = None,
    seed: Annotated[int | None, typer.Option(min=0, max=MOST_SEED, show_default="0")] = None,
    minutes: Annotated[float | None, typer.Option(min=0.1)] = None,
    device: str = "cpu",
    threads: ThreadsOption = None,
    resume: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="runs/train-<network>-seed<seed>")] = None,
    **method: Any,
) -> None:
    """Train a value network or a policy for planners.

    A value network first imitates demonstrations by ORCA, then learns from its own episodes. In validation, the
    lookahead always predicts constant velocity. Of the checkpoints whose success on validation cases is within noise of
    the best, the one with the shortest time to the goal is kept.

    Args:
        scenario: Name of the scenario to train in, or a file: ./mine.toml.
        seed: Seed of the weights and of everything random in training.
        minutes: Train for this many minutes, validations included, instead of --episodes or --steps.
        device: cpu or cuda.
        resume: Continue the interrupted training in this directory, with the options and the number of threads that it
            was started with; only --device and --threads can be different.
        out: Directory for the results.
    """
    use_threads(threads)
    common = {"scenario": scenario, "overrides": overrides, "data": data, "seed": seed, "minutes": minutes}
    run_training(network, common | method, device, threads, resume, out)


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
        threads: The number of threads, which has been set by `use_threads`.
        resume: The directory of an interrupted training, or None.
        out: The directory for the results; None for one in runs/.
        methods: The options of the methods, by the name of the network.

    Raises:
        InputError: An option is impossible, or a file cannot be read or written.
    """
    from crowdbench.train.runner import Runner

    options = {name: value for name, value in options.items() if value is not None}
    if resume is None:
        if "data" in options:
            options["data"] = str(options["data"])
        for name in {"overrides", "ppo"} & options.keys():
            options[name] = assignments(options[name], flag(name))
        config = make_config(network, options, methods)
        announce_compilation()
        runner = Runner.start(config, out or Path("runs") / f"train-{network}-seed{config.seed}", device)
    else:
        if flags := [flag(name) for name in (options if out is None else {**options, "out": out})]:
            raise InputError(
                f"{', '.join(flags)} cannot be changed with --resume: a training goes on with the options that it was "
                "started with, except --device and --threads"
            )
        announce_compilation()
        runner = Runner.resume(resume, device, threads, methods)
        if runner.training.config.network != network:
            raise InputError(f"the training in {resume} is of {runner.training.config.network}, not of {network}")
    _run(runner)


def _run(runner: Runner) -> None:
    """Train to the end with progress, and print the path of the weights."""
    training = runner.training
    with exit_on_interrupt(f"continue with {training.config.program} --resume {runner.directory}"):
        with progress(1.0, "trained") as advance:
            shown = 0.0
            for point in runner.train():
                say(training.describe(point))
                advance(training.progress - shown)
                shown = training.progress
        cases = sum(map(len, training.card_cases.values()))
        with progress(cases, f"of {cases} cases for the card") as advance:
            weights = runner.finish(advance)
    print(f"The best validated network was kept: {' '.join(training.describe(training.best()[0]).split())}")
    print(f"Its card has figures on other cases: {weights.with_suffix('.md')}")
    print(f"The weights are in {weights}; use them with crowdbench {training.config.use} --option weights={weights}")


def with_method_options(
    signature: inspect.Signature, methods: Mapping[str, type[Config]] = METHODS
) -> inspect.Signature:
    """Return a signature with the options of the training methods instead of its last parameter, `**method`."""
    *common, _ = signature.parameters.values()
    parameters = []
    for name, (field, networks) in method_options(methods).items():
        option = typer.Option(
            flag(name),
            min=field.metadata["least"],
            help=f"{field.metadata['help']}.",
            show_default=str(field.default) if field.default else False,
            rich_help_panel=f"Options for {', '.join(networks)} only" if len(methods) > 1 else None,
        )
        kind: Any = list[str] if field.metadata["pairs"] else get_type_hints(methods[networks[0]])[name]
        hint: Any = Annotated[kind | None, option]
        parameters.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=hint))
    return signature.replace(parameters=[*common, *parameters])


# Typer reads the options from the signature.
train.__signature__ = with_method_options(inspect.signature(train))  # type: ignore[attr-defined]
