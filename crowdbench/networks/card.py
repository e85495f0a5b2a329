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
    """A scenario of a card in a few words: its name and its number of pedestrians, or the scene where they walked."""
    if "tracks" in scenario:
        return f"{scenario['name']}, people of {scenario['tracks']['scene']}"
    least, most = scenario["pedestrians"]["number"]
    number = str(least) if least == most else f"{least} to {most}"
    return f"{scenario['name']}, {number} {'pedestrian' if number == '1' else 'pedestrians'}"


def episodes(scenario: Mapping[str, Any]) -> str:
    """What a network has learned from that was trained in episodes of a scenario, in a few words."""
    if "tracks" not in scenario:
        return "simulated episodes only"
    return f"simulated episodes with the recorded tracks of {scenario['tracks']['scene']}"


def rate(estimate: Mapping[str, Any]) -> str:
    """A share of cases with its 95 % interval, in per cent."""
    return f"{100 * estimate['mean']:.1f} % ({100 * estimate['low']:.1f} to {100 * estimate['high']:.1f})"


def seconds(estimate: Mapping[str, Any]) -> str:
    """A mean time with its 95 % interval, in seconds; empty where there was nothing to measure."""
    return f"{estimate['mean']:.2f} s ({estimate['low']:.2f} to {estimate['high']:.2f})" if estimate["n"] else ""


def chosen_on(trained: Mapping[str, Any]) -> str:
    """Return where a checkpoint was chosen, as the end of a sentence."""
    validation = trained["validation"]
    return f", on {validation['cases']} of {' and of '.join(validation['scenarios'])}"


def driving_table(figures: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What a network does as a driver, as lines of Markdown: rates, time, and the jerk where it was measured.

    Args:
        figures: By split, the cases and the metrics with their intervals.
    """
    has_jerk = all("jerk" in each["metrics"] for each in figures.values())
    head = ["cases", "success", "collisions", "time-outs", "navigation time", *["jerk"] * has_jerk]
    rows = [head, ["---"] * len(head)]
    for split, each in figures.items():
        found = each["metrics"]
        rates = [rate(found[f"{outcome}_rate"]) for outcome in ("success", "collision", "timeout")]
        jerk = [f"{found['jerk']['mean']:.2f} m/s³"] if has_jerk else []
        rows.append([f"{split} {each['cases']}", *rates, seconds(found["navigation_time"]), *jerk])
    return [f"| {' | '.join(row)} |" for row in rows]
