"""The card of trained weights as text: their training and their measured results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

CardText = tuple[str, Mapping[str, str], Sequence[str]]
"""The text of a card that depends on the training method: the training and the main figure in one line, further rows of
its table, and the figures as lines of Markdown."""


def headline(card: Mapping[str, Any]) -> str:
    """Return a card in one line."""
    trained = card["training"]
    return f"{card['network']}, seed {trained['seed']}, {trained['minutes']:.1f} min {_text(card)[0]}"


def markdown(card: Mapping[str, Any]) -> str:
    """Return a card in Markdown.

    Args:
        card: The card, as it is in JSON.
    """
    trained, (_, rows, figures) = card["training"], _text(card)
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


def _text(card: Mapping[str, Any]) -> CardText:
    """Return the text of a planner's or of a predictor's card."""
    is_predictor = "ade" in card["figures"].get("validation", {})
    return _predicting_text(card) if is_predictor else _driving_text(card)


def _driving_text(card: Mapping[str, Any]) -> CardText:
    """Return the text of a network that drives: a policy, which has a reward, or a value network."""
    trained, figures, validation = card["training"], card["figures"], card["training"]["validation"]
    setting, where, conditions = f"in {crowd(trained['scenario'])}", "", ""
    if "reward" in trained:
        unit, further = "steps", [_listed(scenario) for scenario in trained["beside"]]
        rows = {"trained beside in": "; ".join(further)} if further else {}
        shown = f"{trained['nearest']} at most, the nearest" if trained["nearest"] else "none, but scans of a lidar"
        rows |= {"reward": str(trained["reward"]), "pedestrians shown": shown}
        if further:
            others = {scenario["name"] for scenario in trained["beside"]} - {trained["scenario"]["name"]}
            setting = f"{setting}, and {len(others)} more scenario{'s' * (len(others) != 1)}"
            where, conditions = f" of {trained['scenario']['name']}", ", not in those beside it"
    else:
        unit, limits = "episodes", ", ".join(f"{name} {limit:g}" for name, limit in trained["limits"].items())
        rows = {"predictor in the lookahead": trained["predictor"]} | ({"limits": limits} if limits else {})
        setting = f"with the {trained['predictor']} predictor {setting}{f', {limits}' if limits else ''}"
        within = " and within the same limits" if limits else ""
        conditions = f"{within}, with the constant-velocity predictor in the lookahead"
    chosen_on = f"{validation['cases']} of {' and of '.join(validation['scenarios'])}"
    chosen = f"chosen at {unit[:-1]} {trained[f'kept_after_{unit}']} of {trained[unit]}, on {chosen_on}"
    scenario = f"{crowd(trained['scenario'])} (digest {trained['scenario']['digest']})"
    split = "test" if "test" in figures else "validation"
    measured = f"Measured once, after training, in the same scenario{conditions} (95 % intervals):"
    summary = f"{setting}: {rate(figures[split]['metrics']['success_rate'])} success on {split} cases{where}"
    return summary, {"scenario": scenario, **rows, "checkpoint": chosen}, [measured, "", *driving_table(figures)]


def _predicting_text(card: Mapping[str, Any]) -> CardText:
    trained, figures = card["training"], card["figures"]["validation"]
    ade, modes, step = f"ADE {figures['ade']:.3f} m", figures["modes"], f"{trained['dt']:g} s"
    simulated = "scenario" in trained
    source = crowd(trained["scenario"]) if simulated else trained["held_out"] or "none"
    rows = {
        "scenario" if simulated else "scene held out": source,
        "time step": step,
        "social pooling": "yes" if trained["pooling"] else "no",
        "training windows": str(trained["windows"]),
        "checkpoint": f"chosen at epoch {trained['kept_after_epochs']} of {trained['epochs']}",
    }
    errors = (
        f"Errors on the {figures['windows']} validation windows, by which the checkpoint was chosen: {ade} and FDE "
        f"{figures['fde']:.3f} m after 8 steps, for the best of {modes} futures, chosen jointly for all "
        "pedestrians of a window."
    )
    summary = f"on {card['data']}; {ade}, best of {modes}, on validation windows with {step} per step"
    return summary, rows, [errors]


def crowd(scenario: Mapping[str, Any]) -> str:
    """Describe a scenario of a card: its name and its number of pedestrians, or the scene of the recorded tracks."""
    if "tracks" in scenario:
        return f"{scenario['name']}, people of {scenario['tracks']['scene']}"
    least, most = scenario["pedestrians"]["number"]
    number = str(least) if least == most else f"{least} to {most}"
    return f"{scenario['name']}, {number} {'pedestrian' if number == '1' else 'pedestrians'}"


def _listed(scenario: Mapping[str, Any]) -> str:
    """Describe a scenario beside the first one, with the number of times it is listed."""
    times = scenario.get("times", 1)
    return crowd(scenario) + (f" ({times} times)" if times > 1 else "")


def episodes(scenarios: Iterable[Mapping[str, Any]]) -> str:
    """Describe the data of a training in episodes of scenarios."""
    scenes = dict.fromkeys(scenario["tracks"]["scene"] for scenario in scenarios if "tracks" in scenario)
    return (
        f"simulated episodes with the recorded tracks of {', '.join(scenes)}" if scenes else "simulated episodes only"
    )


def rate(estimate: Mapping[str, Any]) -> str:
    """Format a share of cases with its 95 % interval, in per cent."""
    return f"{100 * estimate['mean']:.1f} % ({100 * estimate['low']:.1f} to {100 * estimate['high']:.1f})"


def driving_table(figures: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Format the figures of a network that drives, in Markdown: rates, time, and the jerk if it was measured.

    Args:
        figures: By split, the cases and the metrics with their intervals.
    """
    has_jerk = all("jerk" in figure["metrics"] for figure in figures.values())
    head = ["cases", "success", "collisions", "time-outs", "navigation time", *["jerk"] * has_jerk]
    rows = [head, ["---"] * len(head)]
    for split, figure in figures.items():
        metrics, time = figure["metrics"], figure["metrics"]["navigation_time"]
        seconds = f"{time['mean']:.2f} s ({time['low']:.2f} to {time['high']:.2f})" if time["n"] else ""
        rates = [rate(metrics[f"{outcome}_rate"]) for outcome in ("success", "collision", "timeout")]
        jerk = [f"{metrics['jerk']['mean']:.2f} m/s³"] if has_jerk else []
        rows.append([f"{split} {figure['cases']}", *rates, seconds, *jerk])
    return [f"| {' | '.join(row)} |" for row in rows]
