"""The command that measures speed."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.options import print_table
from crowdbench.train.value_request import EPISODES


def bench(
    lookahead: Annotated[
        bool, typer.Option("--lookahead", help="Instead what makes SARL-SGAN-KCE quick, and what that changes.")
    ] = False,
) -> None:
    """Measure the speed here, beside navground's where that is installed."""
    if lookahead:
        _bench_lookahead()
    else:
        _bench_all()


def _bench_lookahead() -> None:
    from crowdbench.bench import futures
    from crowdbench.cli.console import announce_compilation, progress
    from crowdbench.cli.tables import ways_table
    from crowdbench.scenario.cases import Cases

    announce_compilation()
    cases = Cases.parse("val:50")
    planners = futures.planners()
    with progress(len(planners) * len(cases), "episodes") as tell:
        measured = futures.compare(planners, cases, tell)
    print_table(ways_table(f"Ways to decide as SARL-SGAN-KCE, cases {cases}", measured))
    print(
        "\nTimes are of the same decisions, which all ways took in turn. Each way differs from the first in one thing."
    )


def _bench_all() -> None:
    from crowdbench.bench import NAVGROUND, Row
    from crowdbench.bench.measure import measurements
    from crowdbench.cli.console import progress
    from crowdbench.cli.tables import bench_table

    wanted = measurements(EPISODES)
    with progress(len(wanted), "measurements") as tell:
        measured: list[Row] = []
        for measurement in wanted:
            measured += measurement()
            tell(1)
    print_table(bench_table(measured))
    print("\nSARL's decisions are those of random weights, which cost what trained ones cost.")
    print("CrowdNav's figures were recorded beforehand, elsewhere: they are not measured in this run.")
    if not any(row.theirs for row in measured if row.whose == NAVGROUND):
        print("navground is not installed, so its figures are left out: pip install 'crowdbench[bench]'")
