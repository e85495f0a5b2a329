"""Draws the pictures of the docs: `python docs/pictures.py`, or some of them: `python docs/pictures.py suite.png`.

`--check` draws them into a temporary folder instead, and fails where one of them is no longer as in docs/.
"""

import functools
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from noticing_page import draw_noticing, suite_names
from PIL import Image, ImageSequence

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Trace
from crowdbench.figures.episode import Episode, draw_pictures, draw_start, draw_strip, film
from crowdbench.planners.driver import Driver
from crowdbench.record.decisions import draw_decisions, read_paths
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

DOCS = Path(__file__).parent

DIFFERENCE = 2.0
"""Pictures are the same where channels differ by less in the mean, of 255: other machines round otherwise."""

COLUMNS = 4
"""Panels side by side in a picture as wide as a page."""


@dataclass(frozen=True)
class Still(Episode):
    """An episode whose pictures show a fixed square around the middle between start and goal.

    Attributes:
        half: Half the side of the square in metres.
    """

    half: float = 5.5

    def bounds(self, centre: np.ndarray | None = None) -> np.ndarray:
        """See `Episode`."""
        middle = (self.trace.position[self.row, 0, 0] + self.trace.goal[self.row, 0, 0]) / 2.0
        return np.stack([middle - self.half, middle + self.half])


@functools.cache
def drive(planner: str, scenario: str, cases: str, filtered: bool = False) -> Trace:
    """Return the trace of a planner in cases of a scenario; `filtered` is whether it filters noisy measurements."""
    made = load_planner(planner, {"filter": "kalman"} if filtered else {})[1]
    return rollout(Driver(made, planner), load_scenario(scenario), Cases.parse(cases), keep_logs=True)


def draw_suite(out: Path) -> None:
    """Draw case val/0 of each scenario of the suite, driven by MPPI."""
    pictures = []
    for name in suite_names():
        trace = drive("mppi", name, "val/0", filtered=True)
        length = float(np.hypot(*(trace.goal[0, 0, 0] - trace.position[0, 0, 0])))
        episode = Still(trace, 0, title=name, side=7.0 / COLUMNS, half=0.6 * length + 0.8)
        pictures.append(episode.picture(float(episode.end)))
    draw_pictures(pictures, COLUMNS, out)


def draw_race(out: Path) -> None:
    """Make a film of four planners in the same case of a crossing, at twice the speed."""
    episodes = []
    for planner in ("orca", "ppo", "dwa", "mppi"):
        trace = drive(planner, "intersection_16_seen", "val/7")
        paths = read_paths(list(draw_decisions(trace, 0)), trace.rules.dt)
        episodes.append(Still(trace, 0, None, paths, planner, side=320 / 144))
    film(episodes, out, speed=2.0)


def draw_episode(out: Path) -> None:
    """Draw a whole case, with the time along the path."""
    episode = Episode(drive("orca_margin", "circle_crossing_5", "val/5"), 0)
    draw_pictures([episode.picture()], 1, out)


PICTURES: dict[str, Callable[[Path], None]] = {
    "suite.png": draw_suite,
    "race.webp": draw_race,
    "episode.png": draw_episode,
    "strip.png": lambda out: draw_strip(Episode(drive("mppi", "intersection_16", "val/8"), 0, 9.0), 5, out),
    "groups.png": lambda out: draw_start(load_scenario("groups_12"), "test", 3, out),
    **{f"noticing/{name}.png": functools.partial(draw_noticing, name) for name in suite_names()},
}


def differ(one: Path, other: Path) -> bool:
    """Return whether two pictures or films differ."""
    with Image.open(one) as first, Image.open(other) as second:
        if (first.size, getattr(first, "n_frames", 1)) != (second.size, getattr(second, "n_frames", 1)):
            return True
        pairs = zip(ImageSequence.Iterator(first), ImageSequence.Iterator(second), strict=True)
        means = [
            np.abs(np.subtract(*(np.asarray(each.convert("RGB"), float) for each in pair))).mean() for pair in pairs
        ]
        return max(means) > DIFFERENCE


def main(names: list[str]) -> None:
    """Draw pictures, or check them."""
    chosen = [name for name in names if name != "--check"] or list(PICTURES)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) if "--check" in names else DOCS
        for name in chosen:
            (place / name).parent.mkdir(exist_ok=True)
            PICTURES[name](place / name)
        others = [name for name in chosen if differ(place / name, DOCS / name)]
    sys.exit(f"python docs/pictures.py {' '.join(others)} draws other pictures than docs/ has" if others else 0)


if __name__ == "__main__":
    main(sys.argv[1:])
