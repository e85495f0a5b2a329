"""The commands that say what there is, whether a planner keeps the contract, and how fast it all is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated

import typer

from crowdbench.cli.options import CasesOption, LimitOption, OptionOption, ScenarioOption, print_table
from crowdbench.cli.train import EPISODES
from crowdbench.errors import InputError
from crowdbench.settings import DECISION_LIMIT


def list_(
    kind: Annotated[str, typer.Argument(help="planners, pedestrians, predictors, weights, scenarios or metrics.")],
) -> None:
    """List planners, pedestrians, predictors, weights, scenarios or metrics."""
    from crowdbench import catalog
    from crowdbench.cli.tables import listing_table
    from crowdbench.evaluate.metrics import METRICS
    from crowdbench.predict.load import PREDICTORS

    listings: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "planners": catalog.PLANNERS.names,
        "pedestrians": catalog.PEDESTRIANS.names,
        "predictors": lambda: _described(PREDICTORS),
        "weights": catalog.weights,
        "scenarios": catalog.scenarios,
        "metrics": lambda: _described(METRICS),
    }
    if kind not in listings:
        *others, last = listings
        raise InputError(f"nothing is listed as {kind!r}: ask for {', '.join(others)} or {last}")
    print_table(listing_table(kind, listings[kind]()))


def _described(things: Mapping[str, object]) -> list[tuple[str, str]]:
    """Each name with the first line of the docstring."""
    return [(name, (thing.__doc__ or "").partition("\n")[0]) for name, thing in things.items()]


def check(
    planner: Annotated[str, typer.Argument(help="A name, ./mine.py or ./mine.py:factory.")],
    option: OptionOption = None,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "val:20",
    decision_limit: LimitOption = DECISION_LIMIT,
) -> None:
    """Say point by point whether a planner keeps the contract."""
    from crowdbench import catalog
    from crowdbench.cli.console import announce_compilation
    from crowdbench.cli.tables import check_table
    from crowdbench.evaluate.check import check as examine
    from crowdbench.scenario.cases import Cases

    announce_compilation()
    options = catalog.assignments(option or [], "--option")
    name, _ = catalog.load_planner(planner, options)
    points = examine(
        lambda: catalog.load_planner(planner, options)[1],
        name,
        catalog.load_scenario(scenario),
        Cases.parse(cases),
        decision_limit,
    )
    print_table(check_table(name, points))
    if not all(point.kept for point in points):
        raise typer.Exit(1)


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
