"""The picture of the docs that shows the score of one episode: the path, the closeness over time, and the times."""

from pathlib import Path

import numpy as np

from crowdbench.api import rollout
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Trace
from crowdbench.drawing import LIGHT, Disc
from crowdbench.figures.episode_figure import Episode
from crowdbench.figures.style import COLOURS, canvas, draw_panel
from crowdbench.metrics.registry import METRICS
from crowdbench.metrics.score import closeness

PARTS = 25
"""Parts of a step in which the closeness is drawn."""

EVERY = 3
"""Number of these parts from one disc on the path to the next."""

WIDTH = 0.15
"""Half the width of the path in metres where one pedestrian is close."""


def closeness_over_time(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Return times in seconds in the first episode, and the closeness in each, summed over pedestrians."""
    share = (np.arange(PARTS) + 0.5)[:, None, None] / PARTS
    position, size = trace.position[0], trace.radius[0, 0, 0] + trace.radius[0, 0, 1:]
    times, weights = [], []
    for t in range(int(trace.steps[0])):
        between = (1.0 - share) * position[t] + share * position[t + 1]
        gaps = np.hypot(*(between[:, 1:] - between[:, :1]).transpose(2, 0, 1)) - size
        weights += [sum(closeness(gap) for gap in row if np.isfinite(gap)) for row in gaps]
        times += list((t + share[:, 0, 0]) * trace.rules.dt)
    return np.array(times), np.array(weights)


def draw_score(out: Path) -> None:
    """Draw case val/0 of `circle_20`, driven by MPPI."""
    trace = rollout(load_planner("mppi"), load_scenario("circle_20"), "val/0", undisturbed=False)
    value = {name: float(METRICS[name](trace)[0]) for name in ("t_empty", "navigation_time", "t_close", "score")}
    least, time, close = value["t_empty"], value["navigation_time"], value["t_close"]
    times, weights = closeness_over_time(trace)
    colour = {"empty": f"#{bytes(LIGHT.success).hex()}", "time": COLOURS[0], "close": f"#{bytes(LIGHT.contact).hex()}"}
    shapes, bounds, _ = Episode(trace, 0).picture()
    states = np.arange(int(trace.steps[0]) + 1) * trace.rules.dt
    path = np.stack([np.interp(times, states, axis[: len(states)]) for axis in trace.position[0, :, 0].T], axis=1)
    marked = [i for i in range(0, len(times), EVERY) if weights[i] > 0.1]
    shapes += [Disc(path[i], WIDTH * weights[i], LIGHT.contact) for i in marked]
    with canvas(out, 7.0, 3.3) as figure:
        draw_panel(figure, (1, 2, 1), bounds, shapes)
        curve, bars = figure.add_subplot(2, 2, 2), figure.add_subplot(2, 2, 4)
        curve.fill_between(times, weights, color=colour["close"], alpha=0.7, linewidth=0)
        curve.set(xlim=(0, time + close + 1), ylim=(0, 1.1 * weights.max()), xlabel="time, s", ylabel="people close")
        curve.text(time + close, 0.55 * weights.max(), f"area: {close:.2f} s", color=colour["close"], ha="right")
        bars.barh([1], [least], color=colour["empty"], height=0.6)
        bars.barh([0], [time], color=colour["time"], height=0.6)
        bars.barh([0], [close], left=[time], color=colour["close"], height=0.6)
        for x, y, text in (
            (least / 2, 1, f"{least:.2f} s"),
            (time / 2, 0, f"{time:.2f} s"),
            (time + close / 2, 0, f"{close:.2f} s"),
        ):
            bars.text(x, y, text, color="white", ha="center", va="center")
        bars.set(xlim=curve.get_xlim(), ylim=(-0.5, 1.5), xlabel="time, s")
        bars.set_yticks([1, 0], ["T_empty", "T + t_close"])
        bars.set_title(f"score = {least:.2f} / ({time:.2f} + {close:.2f}) = {value['score']:.2f}", loc="left")
