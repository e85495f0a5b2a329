"""The card of trained weights as text: where they come from and what they were measured to do.

What a card says of the training differs between training methods: `crowdbench.train.methods` has the whole text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def markdown(card: Mapping[str, Any], rows: Mapping[str, str], figures: Sequence[str]) -> str:
    """The text of a card.

    Args:
        card: The card, as it is in JSON.
        rows: Further rows of its table, by name.
        figures: What the network was measured to do, as lines of Markdown.

    Returns:
        The text, in Markdown.
    """
    trained = card["training"]
    table = {
        "network": card["network"],
        "command": f"`{card['command']}`",
        "commit": card["commit"] or "not from a checkout",
        "data": card["data"],
        **rows,
        "seed": trained["seed"],
        "training time": f"{trained['minutes']:.1f} min",
        "machine": card["machine"],
        "versions": ", ".join(f"{name} {version}" for name, version in card["versions"].items()),
        "sha256": f"`{card['sha256']}`",
        "licence": card["licence"],
    }
    lines = [f"# {card['network']}, seed {trained['seed']}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in table.items()]
    lines += ["", *figures]
    # Added to the JSON by hand: results in other crowds, measured after the training.
    lines += ["", card["finding"]] if "finding" in card else []
    return "\n".join(lines) + "\n"


def crowd(scenario: Mapping[str, Any]) -> str:
    """A scenario of a card in a few words: its name and its number of pedestrians."""
    least, most = scenario["pedestrians"]["number"]
    number = str(least) if least == most else f"{least} to {most}"
    return f"{scenario['name']}, {number} {'pedestrian' if number == '1' else 'pedestrians'}"


def rate(estimate: Mapping[str, Any]) -> str:
    """A share of cases with its 95 % interval, in per cent."""
    return f"{100 * estimate['mean']:.1f} % ({100 * estimate['low']:.1f} to {100 * estimate['high']:.1f})"


def seconds(estimate: Mapping[str, Any]) -> str:
    """A mean time with its 95 % interval, in seconds; empty where there was nothing to measure."""
    return f"{estimate['mean']:.2f} s ({estimate['low']:.2f} to {estimate['high']:.2f})" if estimate["n"] else ""
