"""The means of metrics over the scenarios of a board, with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from crowdbench.boards.board import Board
from crowdbench.metrics import UNDISTURBED, info_of
from crowdbench.metrics.summary import NOTHING, Estimate


def board_figures(board: Board, scenarios: Mapping[str, Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """The means over the scenarios of a board.

    Args:
        board: The board.
        scenarios: The estimates by scenario and metric; a scenario without any counts as 0.

    Returns:
        The means by metric, each undefined where it is undefined in a scenario; but metrics that compare with the
        undisturbed crowd are means over the scenarios in which pedestrians see the vehicle.
    """
    figures = {}
    for metric in board.metrics:
        each = [estimates.get(metric) for estimates in scenarios.values()]
        shares = board.weights
        if UNDISTURBED in info_of(metric).needs:
            shares = shares * [one is not None and not np.isnan(one.mean) for one in each]
            each = [one if share else None for one, share in zip(each, shares, strict=True)]
            shares = shares / shares.sum() if shares.any() else shares * np.nan
        figures[metric] = over_board(shares, each)
    return figures


def success_by_family(board: Board, scenarios: Mapping[str, Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Success in each family of scenarios of a board, all scenarios alike; arguments as for `board_figures`."""
    families = board.spec.families.items()
    return {
        family: over_board(
            np.full(len(names), 1.0 / len(names)), [scenarios[name].get("success_rate") for name in names]
        )
        for family, names in families
    }


def over_board(shares: Float[np.ndarray, "scenario"], each: Sequence[Estimate | None]) -> Estimate:
    """The mean over the scenarios of a board, each with its share, and its interval by Zou and Donner (2008).

    Args:
        shares: How much each scenario counts.
        each: The estimate in each scenario; None counts as 0.

    Returns:
        The estimate, undefined where one of them is.
    """
    estimates = [Estimate(0.0, 0.0, 0.0, 0, 0.0) if one is None else one for one in each]
    mean = float(shares @ [one.mean for one in estimates])
    if np.isnan(mean):
        return NOTHING
    below, above = np.array([(one.mean - one.low, one.high - one.mean) for one in estimates]).T
    low, high = mean - np.sqrt(np.sum((shares * below) ** 2)), mean + np.sqrt(np.sum((shares * above) ** 2))
    return Estimate(mean, float(low), float(high), sum(one.n for one in estimates), max(one.max for one in estimates))
