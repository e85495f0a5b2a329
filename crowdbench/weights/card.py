"""The card of trained weights, for people: where they come from and what they were measured to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def headline(card: Mapping[str, Any]) -> str:
    """The card in one line."""
    trained, figures = card["training"], card["figures"]
    what = f"{card['network']}, seed {trained['seed']}, {trained['minutes']:.1f} min"
    if "episodes" in trained:
        rate = _rate(figures["test"]["metrics"]["success_rate"])
        return f"{what} with the {trained['predictor']} predictor among {_crowd(card)}: {rate} success on test cases"
    measured = figures["validation"]
    return (
        f"{what}, {card['data']}: ADE {measured['ade']:.3f} m, best of {measured['modes']}, in validation windows of "
        f"{trained['dt']:g} s a step"
    )


def markdown(card: Mapping[str, Any]) -> str:
    """The whole card."""
    trained = card["training"]
    rows = {
        "network": card["network"],
        "command": f"`{card['command']}`",
        "commit": card["commit"] or "not from a checkout",
        "data": card["data"],
        **(_value_rows(card) if "episodes" in trained else _sgan_rows(card)),
        "seed": trained["seed"],
        "training time": f"{trained['minutes']:.1f} min",
        "machine": card["machine"],
        "versions": ", ".join(f"{name} {version}" for name, version in card["versions"].items()),
        "sha256": f"`{card['sha256']}`",
        "licence": card["licence"],
    }
    lines = [f"# {card['network']}, seed {trained['seed']}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows.items()]
    lines += ["", *(_value_figures(card) if "episodes" in trained else _sgan_figures(card))]
    # What was found out later, by hand: how it does elsewhere.
    lines += ["", card["finding"]] if "finding" in card else []
    return "\n".join(lines) + "\n"


def _value_rows(card: Mapping[str, Any]) -> dict[str, str]:
    trained = card["training"]
    return {
        "crowd": f"{_crowd(card)} (digest {trained['scenario']['digest']})",
        "predictor in the lookahead": trained["predictor"],
        "episodes": f"{trained['episodes']}, kept as it was after {trained['kept_after_episodes']}",
    }


def _value_figures(card: Mapping[str, Any]) -> list[str]:
    lines = ["Measured once, after training, in the same crowd, foreseen at constant velocity (95 % intervals):", ""]
    lines += ["| cases | success | collisions | time-outs | navigation time |", "|---|---|---|---|---|"]
    for name, figures in card["figures"].items():
        measured = figures["metrics"]
        rates = [_rate(measured[f"{outcome}_rate"]) for outcome in ("success", "collision", "timeout")]
        lines.append(f"| {name} {figures['cases']} | {' | '.join(rates)} | {_seconds(measured['navigation_time'])} |")
    return lines


def _sgan_rows(card: Mapping[str, Any]) -> dict[str, str]:
    trained = card["training"]
    scenario = trained.get("scenario")
    rows = {"scene held out": trained["held_out"] or "none"} if scenario is None else {"crowd": _crowd(card)}
    return rows | {
        "step": f"{trained['dt']:g} s",
        "pooling": "yes" if trained["pooling"] else "no",
        "windows": str(trained["windows"]),
        "epochs": f"{trained['epochs']}, kept as it was after {trained['kept_after_epochs']}",
    }


def _sgan_figures(card: Mapping[str, Any]) -> list[str]:
    measured = card["figures"]["validation"]
    return [
        f"On {measured['windows']} validation windows, by which what is kept was chosen: best of {measured['modes']} "
        f"futures, jointly for everybody in a window, ADE {measured['ade']:.3f} m and FDE {measured['fde']:.3f} m "
        "after 8 steps.",
    ]


def _crowd(card: Mapping[str, Any]) -> str:
    scenario = card["training"]["scenario"]
    least, most = scenario["pedestrians"]["number"]
    number = str(least) if least == most else f"{least} to {most}"
    return f"{scenario['name']}, {number} {'pedestrian' if number == '1' else 'pedestrians'}"


def _rate(estimate: Mapping[str, Any]) -> str:
    return f"{100 * estimate['mean']:.1f} % ({100 * estimate['low']:.1f} to {100 * estimate['high']:.1f})"


def _seconds(estimate: Mapping[str, Any]) -> str:
    return f"{estimate['mean']:.2f} s ({estimate['low']:.2f} to {estimate['high']:.2f})" if estimate["n"] else ""
