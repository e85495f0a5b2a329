"""The command that measures speed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from crowdbench.cli.console import announce_compilation, progress
from crowdbench.cli.options import ThreadsOption, assignments, help_from_docstring, use_threads
from crowdbench.cli.tables import print_table
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

if TYPE_CHECKING:
    from crowdbench.bench.measurement import Measurement
    from crowdbench.bench.speed_ups import VariantComparison

SCENARIO = "circle_crossing_5"
"""Where a planner's decisions are timed, unless another scenario is named."""

CASES = "val:21"
"""The cases in which a planner's decisions are timed; the first one warms up."""


@help_from_docstring
def bench(
    lookahead: bool = False,
    planner: str | None = None,
    scenario: str = SCENARIO,
    option: list[str] | None = None,
    overrides: list[str] | None = None,
    threads: ThreadsOption = None,
) -> None:
    """Measure the speed of the simulator, of decisions, trainings and whole runs on this machine.

    --scenario, --option, --set and --threads need --planner.

    Args:
        lookahead: Instead, measure the speed-ups of SARL-SGAN-KCE's lookahead and whether they change any command.
        planner: Instead, measure how long this planner takes for a decision in one world alone, in 20 cases. A name
            or a file of your own: ./mine.py.
    """
    if lookahead and planner is not None:
        raise InputError("--lookahead and --planner are different measurements: give one of them")
    if planner is None and (scenario != SCENARIO or option or overrides or threads):
        raise InputError("--scenario, --option, --set and --threads need --planner: say which planner to measure")
    if planner is not None:
        use_threads(threads)
        _bench_planner(planner, scenario, assignments(option or [], "--option"), assignments(overrides or [], "--set"))
    elif lookahead:
        _bench_lookahead()
    else:
        _bench_all()


def _bench_planner(planner: str, scenario: str, options: dict[str, Any], overrides: dict[str, Any]) -> None:
    import numpy as np

    from crowdbench import catalog
    from crowdbench.runs.decision_time import decide_alone
    from crowdbench.runs.results import planner_label
    from crowdbench.runs.spec import EVERY_STEP
    from crowdbench.scenario.cases import Cases

    announce_compilation()
    name, loaded = catalog.load_planner(planner, options)
    place, cases = catalog.load_scenario(scenario, overrides), Cases.parse(CASES)
    with progress(len(cases) - 1) as tell:
        seconds = decide_alone(loaded, name, place, EVERY_STEP, cases, progress=tell).seconds
    median, late = 1e3 * np.percentile(seconds, [50, 99])
    print(
        f"{planner_label(name, options)} on {place.name}: {len(seconds)} decisions in one world alone take "
        f"{median:.3g} ms (median), {late:.3g} ms (99th percentile); a step takes {1e3 * place.rules.dt:g} ms"
    )


def _bench_lookahead() -> None:
    from crowdbench.bench import speed_ups
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
    from crowdbench.bench.suite import SUITE

    measured: list[Measurement] = []
    with progress(len(SUITE), f"of {len(SUITE)} measurements") as tell:
        for measure in SUITE:
            measured += measure()
            tell(1)
    print_table(bench_table(measured))
    print("\nSARL's decisions are made with random weights, which cost as much as trained ones.")
    print("CrowdNav's times were recorded earlier, on another machine: they are not measured in this run.")


def bench_table(measured: list[Measurement]) -> Grid:
    """Measured speeds; the ratio says how many times less time crowdbench takes than CrowdNav's code."""
    rows = []
    for one in measured:
        crowdnav = "" if one.crowdnav is None else f"{one.crowdnav:.3g} {one.unit}"
        ratio = "" if one.ratio is None else f"{one.ratio:.1f}x"
        rows.append((one.work, f"{one.value:.3g} {one.unit}", crowdnav, ratio))
    return Grid("Speed", ("work", "crowdbench", "CrowdNav, recorded", "ratio"), rows, align="lrrr")


def variants_table(title: str, measured: VariantComparison) -> Grid:
    """How long each variant of the lookahead takes, how many times faster than the first it is, and what it changes."""
    rows = [
        (
            variant.name,
            f"{variant.seconds:.3g} s",
            f"{measured.variants[0].seconds / variant.seconds:.1f}x",
            f"{variant.changed_outcomes} of {measured.episodes:,}",
            f"{variant.changed_commands} of {measured.decisions:,}",
        )
        for variant in measured.variants
    ]
    return Grid(
        title, ("variant", "time", "ratio", "outcomes that differ", "commands that differ"), rows, align="lrrrr"
    )
