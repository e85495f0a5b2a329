"""Draws the pictures of the docs: `python docs/pictures.py`, or some of them: `python docs/pictures.py suite.svg`.

Figures in SVG have the light palette, and the dark palette on dark pages.

`--check` draws them into a temporary folder instead, and fails if one of them differs from docs/.
"""

import functools
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import curve_pictures
import episode_pictures
import numpy as np
import themed_svg
from cross_film import draw_card, draw_cross
from cross_play_picture import draw_cross_play
from fleet_film import draw_fleet
from noticing_page import draw_noticing, suite_names
from PIL import Image, ImageSequence
from rank_picture import draw_ranks
from score_picture import draw_score
from viewer_picture import NoViewer

from crowdbench.runs.spec import EVERY_STEP, Replanning

DOCS = Path(__file__).parent

DIFFERENCE = 2.0
"""Mean difference of channels, of 255, up to which pictures count as equal: machines differ in rounding."""

PICTURES: dict[str, Callable[[Path], None]] = {
    "suite.svg": episode_pictures.draw_suite,
    "cross_light.webp": functools.partial(draw_cross, "default"),
    "cross_dark.webp": functools.partial(draw_cross, "slate"),
    "card.png": draw_card,
    "episode.svg": episode_pictures.draw_episode,
    "strip.svg": episode_pictures.draw_moments,
    "step.svg": episode_pictures.draw_step,
    "groups.svg": episode_pictures.draw_groups,
    "fleet.svg": draw_fleet,
    "fleet_matrix.svg": curve_pictures.draw_matrix,
    "faults.svg": episode_pictures.draw_faults,
    "decision.png": episode_pictures.draw_decision,
    "score.svg": draw_score,
    "ranks.svg": draw_ranks,
    "success.svg": curve_pictures.draw_success,
    "curves.svg": curve_pictures.draw_curves,
    "ladders.svg": curve_pictures.draw_ladders,
    "../studies/cross_play/scores.svg": draw_cross_play,
    "../studies/dials/dial_density.svg": curve_pictures.draw_dial,
    "../studies/li2020/figure3.svg": functools.partial(episode_pictures.draw_paper, "circle_crossing_10", EVERY_STEP),
    "../studies/li2020/figure4.svg": functools.partial(
        episode_pictures.draw_paper, "circle_crossing_5", Replanning(every=8, look_first=8)
    ),
    **{f"noticing/{name}.svg": functools.partial(draw_noticing, name) for name in suite_names()},
}
"""The function that draws each picture, by the path of the picture relative to docs/."""


def differ(one: Path, other: Path) -> bool:
    """Return whether two pictures or films differ."""
    if one.suffix == ".svg":
        return themed_svg.differ(one.read_text(), other.read_text())
    with Image.open(one) as first, Image.open(other) as second:
        if (first.size, getattr(first, "n_frames", 1)) != (second.size, getattr(second, "n_frames", 1)):
            return True
        pairs = zip(ImageSequence.Iterator(first), ImageSequence.Iterator(second), strict=True)
        means = [
            np.abs(np.subtract(*(np.asarray(each.convert("RGB"), float) for each in pair))).mean() for pair in pairs
        ]
        return bool(max(means) > DIFFERENCE)


def main(names: list[str]) -> None:
    """Draw pictures, or check them."""
    chosen = [name for name in names if name != "--check"] or list(PICTURES)
    others = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "docs" if "--check" in names else DOCS
        for name in chosen:
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            try:
                PICTURES[name](place / name)
            except NoViewer as error:
                print(f"{name} is not drawn: {error}")
                continue
            if name.endswith(".svg"):
                themed_svg.adapt(place / name)
            others += [name] * differ(place / name, DOCS / name)
    sys.exit(f"python docs/pictures.py {' '.join(others)} draws other pictures than docs/ has" if others else 0)


if __name__ == "__main__":
    main(sys.argv[1:])
