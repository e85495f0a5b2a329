"""The family of SARL: one network's lookahead, with this or that predictor and part of KCE."""

from __future__ import annotations

from crowdbench.errors import InputError
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.lookahead.aggregate import find_aggregate
from crowdbench.planners.lookahead.kce import ChangeCost, Exploration, Limits, PrintedShaping
from crowdbench.predict.load import load_predictor
from crowdbench.value.networks import load_network

KCE = {"filter", "reward", "explore"}
"""The parts of KCE: equations 5 and 6, equation 8, and equation 9 of Li et al."""


def sarl_planner(
    predictor: str,
    weights: str = "sarl",
    device: str = "cpu",
    modes: int | None = None,
    aggregate: str = "mean",
    shortlist: int | None = None,
    kce: str = "none",
    cost: float = 0.006,
    threshold: float | None = None,
    epsilon: float = 0.1,
    n: int = 2,
    max_velocity_change: float = 1.16,
) -> ValuePlanner:
    """`weights` and `predictor` are names (`crowdbench list`) or files; `device` is cpu or cuda.

    `modes` is the number of futures, for a predictor that has several, which are valued as `aggregate` says: crowd,
    mean or worst; see `ValuePlanner` for `shortlist`. `kce` is none, all, or some of filter, reward and explore,
    joined by "+". The options after it are its parts' (`planners.lookahead.kce`): with a `threshold`, the reward is
    the printed one, and otherwise each change of velocity has its `cost`; a `max_velocity_change` of twice the
    preferred speed bounds nothing. Raises InputError where an option is impossible.
    """
    parts = _parts(kce)
    return ValuePlanner(
        predictor=load_predictor(predictor, {} if modes is None else {"modes": modes})[1],
        value=load_network("sarl", weights, device),
        shaping=shaping(cost, threshold) if "reward" in parts else None,
        aggregate=find_aggregate(aggregate),
        limits=Limits(max_velocity_change=max_velocity_change) if "filter" in parts else None,
        explore=Exploration(epsilon, n) if "explore" in parts else None,
        shortlist=shortlist,
    )


def shaping(cost: float, threshold: float | None) -> ChangeCost | PrintedShaping:
    """The reward's shaping: equation 8 to the letter if it is given its `threshold`."""
    return ChangeCost(cost) if threshold is None else PrintedShaping(threshold)


def _parts(kce: str) -> set[str]:
    parts = {"none": set(), "all": KCE}.get(kce, set(str(kce).split("+")))
    if not parts <= KCE:
        raise InputError(f"kce is {kce!r}, but must be none, all, or some of {', '.join(sorted(KCE))}, joined by +")
    return parts
