"""Fit the parameters of a pedestrian policy and of its population to recorded people."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer
from jaxtyping import Float

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, announce_compilation, help_from_docstring, main, progress, use_threads
from crowdbench.plugins import plugin_name
from crowdbench.utils import require_positive, write_whole

if TYPE_CHECKING:
    from studies.people.windows import Window

ROLLOUTS = 8
"""Rollouts of a window in a trial; the score of a model has more."""

OFFSPRING = 10
"""Trials of a generation of CMA-ES."""

MOST_CONTACTS = 1.2
"""A trial loses if the ratio of new contacts to recorded ones is above this number, or below its inverse."""

LOSS = 0.1
"""Loss of v3 for each factor of 2 by which the ratio is outside these bounds."""


class Bounds(NamedTuple):
    """Bounds of a parameter, and its value in the first trial. The search is in its logarithm."""

    low: float
    start: float
    high: float


POPULATION: Mapping[str, Bounds] = {
    "noise": Bounds(0.02, 0.2, 0.6),
    "noise_time": Bounds(0.3, 1.0, 5.0),
    "inertia": Bounds(0.3, 3.0, 8.0),
    "shrinkage": Bounds(0.005, 0.05, 0.9),
    "spread.preferred_speed": Bounds(0.01, 0.15, 0.4),
    "spread.inertia": Bounds(0.05, 0.5, 1.0),
}
"""Parameters of the population, for all policies."""

SPREAD = Bounds(0.05, 0.5, 0.8)
"""Spread of the policy's parameters, the same one for all of them."""

_ORCA = {
    "time_horizon": Bounds(1.0, 2.0, 4.0),
    "neighbor_distance": Bounds(2.0, 3.5, 6.0),
    "personal_space": Bounds(0.8, 1.2, 1.6),
}

POLICIES: Mapping[str, Mapping[str, Bounds]] = {
    "straight": {},
    "orca_people": _ORCA,
    "learned_people": _ORCA,
    "power_law_people": {"interaction_energy": Bounds(0.1, 1.0, 6.0), "interaction_horizon": Bounds(0.5, 2.5, 8.0)},
    "social_force": {"repulsion_strength": Bounds(0.02, 0.1, 3.0), "repulsion_range": Bounds(0.1, 0.3, 1.0)},
}
"""The fitted parameters of each policy, which differ between people."""


@help_from_docstring
def fit(
    policy: str,
    data: Annotated[Path, typer.Option()],
    out: Annotated[Path, typer.Option()],
    held_out: str = "",
    generations: int = 20,
    threads: ThreadsOption = None,
) -> None:
    """Write the options of the best trial of CMA-ES on all locations but one as JSON, for `run.py --fits`.

    Args:
        policy: One of `POLICIES`, or a file with a policy of such a name.
        data: The folder with the tracks of ETH/UCY.
        out: The folder of the file, which has the name of the location that takes no part, or `all`.
        held_out: The location that takes no part; none if not given.
        generations: Number of generations of trials.
    """
    require_positive("--generations", generations)
    use_threads(threads)
    from studies.people.windows import FOLDS, read_windows

    if plugin_name(policy) not in POLICIES:
        raise InputError(f"policy is {policy!r}, but must be one of {', '.join(POLICIES)}")
    if held_out and held_out not in FOLDS:
        raise InputError(f"--held-out is {held_out!r}, but must be one of {', '.join(FOLDS)}")
    announce_compilation()
    locations = [name for name in FOLDS if name != held_out]
    windows = [window for each in read_windows(data, locations).values() for window in each]
    bounds = parameter_bounds(policy)
    best, value = search(policy, windows, bounds, generations)
    facts = {"policy": policy, "locations": locations, "trials": generations * OFFSPRING, "score": round(value, 4)}
    out.mkdir(parents=True, exist_ok=True)
    with write_whole(out / f"{held_out or 'all'}.json") as file:
        file.write_text(json.dumps(facts | {"options": options_of(policy, best)}, indent=2) + "\n")


def search(
    policy: str, windows: Sequence[Window], bounds: Mapping[str, Bounds], generations: int
) -> tuple[dict[str, float], float]:
    """Return the best parameters that CMA-ES (Hansen 2016, arXiv:1604.00772) finds, and their value."""
    import cma

    low, start, high = np.log(np.array(list(bounds.values()))).T
    settings = {"bounds": [0.0, 1.0], "popsize": OFFSPRING, "seed": 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy((start - low) / (high - low), 0.2, settings)

    def parameters(point: Float[np.ndarray, "parameter"]) -> dict[str, float]:
        return dict(zip(bounds, np.exp(low + point * (high - low)).round(4).tolist(), strict=True))

    best, value = parameters(strategy.x0), -np.inf
    with progress(generations * OFFSPRING) as report:
        for _ in range(generations):
            points = strategy.ask()
            trials = [parameters(point) for point in points]
            values = [judge(policy, windows, trial) for trial in trials]
            strategy.tell(points, [-each for each in values])
            if max(values) > value:
                best, value = trials[int(np.argmax(values))], max(values)
            report(OFFSPRING)
    return best, value


def judge(policy: str, windows: Sequence[Window], parameters: Mapping[str, float]) -> float:
    """Return v3 of a trial, less a loss if new contacts are far more or less frequent than recorded."""
    from studies.people.likelihood import score
    from studies.people.simulate import simulate
    from studies.people.summary import figures

    found = figures(score(windows, simulate(policy, windows, options_of(policy, parameters), rollouts=ROLLOUTS)))
    if not np.isfinite(found["ratio"]):  # no new contact is recorded
        return found["v3"]
    excess = abs(np.log2(max(found["ratio"], 1e-3))) - np.log2(MOST_CONTACTS)
    return float(found["v3"] - LOSS * max(0.0, excess))


def options_of(policy: str, parameters: Mapping[str, float]) -> dict[str, Any]:
    """Return the options of `run.py` for parameters by the names of `POPULATION` and `POLICIES`."""
    from studies.people.simulate import load_policy

    own, key = POLICIES[plugin_name(policy)], "population"
    if not load_policy(policy, {}).crowd.variation:  # the policy brings no population of its own
        key = "pedestrians.population"
    population: dict[str, Any] = {name: parameters[name] for name in POPULATION if "." not in name}
    spread = {name: parameters[f"spread.{name}"] for name in ("preferred_speed", "inertia")}
    spread |= {name: parameters["spread"] for name in own}
    return {**{name: parameters[name] for name in own}, key: {**population, "spread": spread}}


def parameter_bounds(policy: str) -> dict[str, Bounds]:
    """Return the bounds of the fitted parameters of a policy, which has one of the names in `POLICIES`."""
    own = POLICIES[plugin_name(policy)]
    return {**POPULATION, **({"spread": SPREAD, **own} if own else {})}


if __name__ == "__main__":
    main(fit)
