"""Parts of a recording beside the plane: text, and curves over time: gap, speed, and what the planner logged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.core.geometry import norm
from crowdbench.core.types import DISCOMFORT_GAP, Outcome, Trace
from crowdbench.record import decisions
from crowdbench.record.marks import APPROACH_KEY, SENSOR_KEY, SHARES_KEY
from crowdbench.record.rrd import moments, moving

KEY = "*yellow: vehicle, blue: pedestrians, small dots: their goals · arrow: the way of 1 s · grid: 1 m*"
"""Legend of the picture."""

PLANNER_PLOTS = "plots/planner"
"""Path of the planner's own curves."""


def draw_plots(trace: Trace, row: int) -> Iterator[Chunk]:
    """Gap and speed over time, with the values to compare them with. Their colours are in the blueprint."""
    steps, dt = int(trace.steps[row]), trace.rules.dt
    gap = trace.gap[row, :steps]
    somebody = np.isfinite(gap)
    if somebody.any():
        curves = np.stack([gap, np.full(steps, DISCOMFORT_GAP), np.zeros(steps)], axis=1)
        yield _draw_curves("plots/gap", moments(np.flatnonzero(somebody) + 1, dt), curves[somebody])
    speed = norm(trace.velocity[row, : steps + 1, 0])
    preferred = np.full(steps + 1, trace.preferred_speed[row, 0])
    yield _draw_curves("plots/speed", moments(np.arange(steps + 1), dt), np.stack([speed, preferred], axis=1))


def draw_logs(trace: Trace, row: int) -> Iterator[Chunk]:
    """Yield the planner's logs that are curves, see `Observation.log`. How it is drawn is in the blueprint."""
    for name, array in trace.logs.items():
        # Steps without a value are left out, because Rerun draws no curve between values separated by NaN.
        logged_at = decisions.steps_logged(trace, row, name)
        if is_curve(array) and len(logged_at):
            curves = array[row, logged_at].reshape(len(logged_at), -1)
            yield _draw_curves(f"{PLANNER_PLOTS}/{name}", moments(logged_at, trace.rules.dt), curves)


def _draw_curves(entity: str, timeline: Sequence[rr.TimeColumn], values: Float[np.ndarray, "time curve"]) -> Chunk:
    """Curves of one entity over time."""
    return moving(entity, timeline, [values.shape[1]] * len(values), rr.Scalars.columns(scalars=values.ravel()))


def logged_curves(chunks: Iterable[Chunk]) -> dict[str, int]:
    """The curves of `draw_logs` in the chunks of a recording: how many there are by each name, in order."""
    curves = {}
    for chunk in chunks:
        name = chunk.entity_path.removeprefix(f"/{PLANNER_PLOTS}/")
        if name != chunk.entity_path and not chunk.is_static and chunk.num_rows:
            curves[name] = len(chunk.to_record_batch().column("Scalars:scalars")[0])
    return dict(sorted(curves.items()))


def is_curve(logged: np.ndarray) -> bool:
    """Return whether a logged array `[world, step, ...]` is shown as curves over time."""
    return logged.ndim <= 3


def summary_text(trace: Trace, row: int, title: str, sentence: str) -> str:
    """The text beside the picture: which case of which run it is, how it ended, and what the marks mean."""
    lines = [f"# {Outcome(int(trace.outcome[row])).label.capitalize().replace('_', ' ')}: {sentence}"]
    hit = trace.outcome[row] == Outcome.COLLISION
    keys = [KEY, APPROACH_KEY, SHARES_KEY * bool(hit), SENSOR_KEY * (trace.perceived is not None)]
    keys.append(decisions.key_text(trace))
    lines += [f"case {trace.split}/{trace.case[row]} · {title}", "", " · ".join(filter(None, keys))]
    return "\n".join(lines)


def metrics_text(values: Mapping[str, float | bool]) -> str:
    """The metrics of an episode, by names with units, in two columns; those that are undefined are left out."""
    defined = {name: value for name, value in values.items() if np.isfinite(value)}
    cells = [f"{name} | {_value_text(value)}" for name, value in defined.items()]
    cells += [" | "] * (len(cells) % 2)
    half = len(cells) // 2
    lines = ["| metric | value | metric | value |", "|---|---:|---|---:|"]
    lines += [f"| {left} | {right} |" for left, right in zip(cells[:half], cells[half:], strict=True)]
    return "\n".join(lines)


def _value_text(value: float | bool) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else f"{value:.4g}"
