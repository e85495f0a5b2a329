"""Pictures of the docs that show episodes from above, and a film."""

import dataclasses
import functools
import tempfile
from dataclasses import dataclass
from itertools import filterfalse
from pathlib import Path

import numpy as np
from noticing_page import suite_names
from PIL import Image
from viewer_picture import take_picture

import crowdbench
from crowdbench.api import rollout
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Observation, Trace
from crowdbench.drawing import LIGHT, Moment, Polygon, Shape, draw_bands, draw_moment
from crowdbench.figures.episode_figure import (
    WHOLE,
    Episode,
    Picture,
    draw_pictures,
    draw_start,
    draw_strip,
    stored_episodes,
)
from crowdbench.metrics.fault import SMALL_SHARE, WINDOW, Fault, find_contacts
from crowdbench.planners.planner import Planner
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_stored_scenario
from crowdbench.runs.spec import EVERY_STEP, Replanning

COLUMNS = 4
"""Number of panels side by side in a picture of the width of a page."""

RECENT, AROUND = 9, 4.5
"""Number of states, and distance in metres on each side of the vehicle, in the picture of the suite."""

FAULTS = {
    "struck standing": (Fault.STRUCK_STANDING, "waiting", 4),
    "struck from behind": (Fault.STRUCK_BEHIND, "orca", 16),
    "struck otherwise": (Fault.STRUCK, "orca", 45),
    "hit alone": (Fault.ALONE, "orca", 59),
    "hit both": (Fault.BOTH, "orca", 5),
}
"""Kinds of collisions with an example in `streets_16_blind`: the planner, and the number of a validation case."""

DECIDED, LATER = 16, 20
"""The states before and after a decision in the picture of a step, one second apart."""

REACH = 1.6
"""Distance in metres that a picture of a collision shows on each side of the contact."""


@dataclass(frozen=True)
class Still(Episode):
    """An episode whose pictures show a fixed square around the midpoint of start and goal.

    Attributes:
        half: Half the side of the square in metres.
    """

    half: float = 5.5

    def bounds(self, centre: np.ndarray | None = None) -> np.ndarray:
        """See `Episode`."""
        middle = (self.trace.position[self.row, 0, 0] + self.trace.goal[self.row, 0, 0]) / 2.0
        return np.stack([middle - self.half, middle + self.half])


class Waiting(Planner):
    """Planner of a vehicle that stands still."""

    def plan(self, obs: Observation) -> np.ndarray:
        """Return a velocity of 0 m/s."""
        return np.zeros((len(obs), 2))


@functools.cache
def drive(planner: str, scenario: str, cases: str, replanning: Replanning = EVERY_STEP) -> Trace:
    """Return the trace of a planner in cases of a scenario."""
    made = Waiting() if planner == "waiting" else load_planner(planner)
    return rollout(made, scenario, cases, replanning=replanning, keep_logs=True)


def draw_suite(out: Path) -> None:
    """Draw the moment of the smallest gap in case val/0 of each scenario of the suite, driven by MPPI."""
    pictures = []
    for name in suite_names():
        trace = drive("mppi", name, "val/0")
        gap = trace.gap[0, : trace.steps[0]]
        state = int(gap.argmin()) + 1
        moment = Moment.of_trace(trace, 0, state)
        recent = {
            each: getattr(moment, each)[-RECENT:] for each in ("step", "position", "velocity", "heading", "person")
        }
        vehicle = trace.position[0, state, 0]
        plane = np.stack([vehicle - AROUND, vehicle + AROUND])
        note = ("contact", LIGHT.contact) if gap.min() < 0.0 else (f"gap {gap.min():.2f} m", LIGHT.text)
        bands, bounds, inch = draw_bands(plane, WHOLE / COLUMNS, note, name)
        pictures.append(([*draw_moment(dataclasses.replace(moment, **recent)), *bands], bounds, inch))
    draw_pictures(pictures, COLUMNS, out)


def draw_episode(out: Path) -> None:
    """Draw a whole case, with the time along the path."""
    draw_pictures([Episode(drive("orca_margin", "circle_crossing_5", "val/5"), 0).picture()], 1, out)


def draw_moments(out: Path) -> None:
    """Draw five moments of a case at an intersection."""
    draw_strip(Episode(drive("mppi", "streets_16_blind", "val/8"), 0, 9.0), 5, out)


def draw_groups(out: Path) -> None:
    """Draw the start of a case with groups."""
    draw_start(load_scenario("groups_12"), "val", 3, out)


def draw_paper(scenario: str, replanning: Replanning, out: Path) -> None:
    """Draw the first validation case of a scenario, driven with three predictors, as in Li et al. (2020)."""
    traces = {name: drive(name, scenario, "val/0", replanning) for name in ("sarl_lin", "sarl_cvm", "sarl_sgan")}
    episodes = [Still(trace, 0, title=name, side=WHOLE / 3, half=5.0) for name, trace in traces.items()]
    draw_pictures([episode.picture() for episode in episodes], 3, out)


def draw_faults(out: Path) -> None:
    """Draw a collision of each kind."""
    draw_pictures([draw_fault(title, *example) for title, example in FAULTS.items()], len(FAULTS), out)


def draw_fault(title: str, kind: Fault, planner: str, case: int) -> Picture:
    """Return a picture of the two agents in contact at the end of a case, with their motion of the last second."""
    trace = drive(planner, "streets_16_blind", f"val/{case}")
    contacts, end = find_contacts(trace), int(trace.steps[0])
    if contacts.fault[0] != kind:
        raise ValueError(f"case val/{case} of {planner} is no example of {title}")
    states, pair = slice(max(0, end - round(WINDOW / trace.rules.dt)), end + 1), [0, int(contacts.agent[0])]
    moment = Moment.of_trace(trace, 0, end)
    moment = dataclasses.replace(
        moment,
        **{name: getattr(moment, name)[states][:, pair] for name in ("position", "velocity")},
        **{name: getattr(moment, name)[pair] for name in ("goal", "radius")},
        **{name: getattr(moment, name)[states] for name in ("step", "heading")},
        person=moment.person[states][:, [pair[1] - 1]],
        **{name: getattr(moment, name)[[pair[1] - 1]] for name in ("seen", "measured")},
    )
    middle = moment.position[-1].mean(axis=0)
    share = contacts.share[0]
    note = f"{100 * share:.0f} %", LIGHT.contact if share >= SMALL_SHARE else LIGHT.text
    bands, bounds, inch = draw_bands(np.stack([middle - REACH, middle + REACH]), WHOLE / len(FAULTS), note, title)
    # Without the star of a contact, which every picture would have.
    return [*filterfalse(is_star, draw_moment(moment)), *bands], bounds, inch


def is_star(shape: Shape) -> bool:
    """Return whether a shape is the star of a contact."""
    return isinstance(shape, Polygon) and shape.edge == LIGHT.contact


def draw_step(out: Path) -> None:
    """Draw a decision of MPPI: the tracks that it observes, the paths that it considers, and the next second."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        track = {"sensor.track": "realistic"}
        crowdbench.run(
            "mppi", "groups_12", "val:10:11", overrides=track, out=run, record="all", progress=lambda _: None
        )
        [episode] = stored_episodes([RunResult.read(run)], 10, load_stored_scenario, 7.0)
    panels = {"observe": (DECIDED, {}), "decide": (DECIDED, episode.paths), "move": (LATER, {})}
    pictures = [
        dataclasses.replace(episode, title=title, side=WHOLE / 3, paths=paths).picture(float(state))
        for title, (state, paths) in panels.items()
    ]
    draw_pictures(pictures, len(panels), out)


def draw_decision(out: Path) -> None:
    """Draw a decision with tracks of pedestrians in the Rerun viewer, without its empty menu."""
    with tempfile.TemporaryDirectory() as folder:
        run, shot = Path(folder) / "run", Path(folder) / "shot.png"
        crowdbench.run(
            "sarl_cvm",
            "groups_12",
            "val:10:11",
            overrides={"sensor.track": "realistic"},
            out=run,
            record="all",
            progress=lambda _: None,
        )
        take_picture(run / "run.rrd", 8.0, shot)
        with Image.open(shot) as picture:
            width, height = picture.size
            shown = picture.convert("RGB").crop((0, 72, width, height)).reduce(2)
        shown.quantize(dither=Image.Dither.NONE).save(out, optimize=True)
