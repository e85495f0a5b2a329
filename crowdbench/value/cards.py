"""The card of trained weights, for people: where they come from and what they were measured to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def headline(card: Mapping[str, Any]) -> str:
    """The card in one line."""
    trained, test = card["training"], card["figures"]["test"]
    return (
        f"{card['network']}, seed {trained['seed']}, {trained['minutes']:.1f} min with the {trained['predictor']} "
        f"predictor among {_scenario(card)}: {_rate(test['metrics']['success_rate'])} success on test cases"
    )


def markdown(card: Mapping[str, Any]) -> str:
    """The whole card."""
    trained = card["training"]
    rows = {
        "network": card["network"],
        "command": f"`{card['command']}`",
        "commit": card["commit"] or "not from a checkout",
        "data": card["data"],
        "crowd": f"{_scenario(card)} (digest {trained['scenario']['digest']})",
        "predictor in the lookahead": trained["predictor"],
        "seed": trained["seed"],
        "episodes": f"{trained['episodes']}, kept as it was after {trained['kept_after_episodes']}",
        "training time": f"{trained['minutes']:.1f} min",
        "machine": card["machine"],
        "versions": ", ".join(f"{name} {version}" for name, version in card["versions"].items()),
        "sha256": f"`{card['sha256']}`",
        "licence": card["licence"],
    }
    lines = [f"# {card['network']}, seed {trained['seed']}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows.items()]
    lines += [
        "",
        "Measured once, after training, in the same crowd, foreseen at constant velocity (95 % intervals):",
        "",
    ]
    lines += ["| cases | success | collisions | time-outs | navigation time |", "|---|---|---|---|---|"]
    for name, figures in card["figures"].items():
        measured = figures["metrics"]
        rates = [_rate(measured[f"{outcome}_rate"]) for outcome in ("success", "collision", "timeout")]
        lines.append(f"| {name} {figures['cases']} | {' | '.join(rates)} | {_seconds(measured['navigation_time'])} |")
    return "\n".join(lines) + "\n"


def _scenario(card: Mapping[str, Any]) -> str:
    scenario = card["training"]["scenario"]
    least, most = scenario["pedestrians"]["number"]
    return f"{scenario['name']}, {least if least == most else f'{least} to {most}'} pedestrians"


def _rate(estimate: Mapping[str, Any]) -> str:
    return f"{100 * estimate['mean']:.1f} % ({100 * estimate['low']:.1f} to {100 * estimate['high']:.1f})"


def _seconds(estimate: Mapping[str, Any]) -> str:
    return f"{estimate['mean']:.2f} s ({estimate['low']:.2f} to {estimate['high']:.2f})" if estimate["n"] else ""
