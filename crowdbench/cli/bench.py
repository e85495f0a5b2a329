"""The command that measures speed."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.options import print_table


def bench(
    lookahead: Annotated[
        bool,
        typer.Option(
            "--lookahead",
            help="Instead, measure the speed-ups of SARL-SGAN-KCE's lookahead and whether they change any command.",
        ),
    ] = False,
) -> None:
    """Measure the speed of the simulator, of decisions, trainings and whole runs on this machine."""
    if lookahead:
        _bench_lookahead()
    else:
        _bench_all()


def _bench_lookahead() -> None:
    from crowdbench.bench import speed_ups
    from crowdbench.cli.console import announce_compilation, progress
    from crowdbench.cli.tables import variants_table
    from crowdbench.scenario.cases import Cases

    announce_compilation()
    cases = Cases.parse("val:50")
    planners = speed_ups.variants()
    episodes = len(planners) * len(cases)
    with progress(episodes, f"of {episodes} episodes") as tell:
        measured = speed_ups.compare(planners, cases, tell)
    print_table(variants_table(f"Variants of SARL-SGAN-KCE's lookahead, cases {cases}", measured))
    print("\nTimes are of decisions on the same observations, by turns.")
    print("Each variant differs from the first one in one thing.")


def _bench_all() -> None:
    from crowdbench.bench.measurement import Measurement
    from crowdbench.bench.suite import SUITE
    from crowdbench.cli.console import progress
    from crowdbench.cli.tables import bench_table

    measured: list[Measurement] = []
    with progress(len(SUITE), f"of {len(SUITE)} measurements") as tell:
        for measure in SUITE:
            measured += measure()
            tell(1)
    print_table(bench_table(measured))
    print("\nSARL's decisions are made with random weights, which cost as much as trained ones.")
    print("CrowdNav's times were recorded earlier, on another machine: they are not measured in this run.")
