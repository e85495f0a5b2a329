"""Draws docs/suite.png, how each scenario of the suite starts: python docs/suite_figure.py."""

import tomllib
from pathlib import Path

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.drawing import Moment, draw_moment, extent
from crowdbench.figures.episode import draw
from crowdbench.figures.style import canvas
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

DOCS = Path(__file__).parent
COLUMNS, SIDE = 5, 1.9
"""Panels side by side, and the side of one in inches."""


def main() -> None:
    """Write the figure."""
    study = tomllib.loads((DOCS.parent / "studies" / "suite" / "study.toml").read_text())
    names = [name for crowd in study["crowds"] for name in crowd["scenarios"]]
    rows = -(-len(names) // COLUMNS)
    with canvas(DOCS / "suite.png", COLUMNS * SIDE, rows * (SIDE + 0.15)) as figure:
        for place, name in enumerate(names, start=1):
            driver = Driver(load_planner("straight")[1], "straight")
            trace = rollout(driver, load_scenario(name), Cases("test", 0, 1))
            low, high = extent(trace.position[0, :1], trace.goal[0, :1, 0], trace.obstacles[0], 0.7)
            axes = figure.add_subplot(rows, COLUMNS, place)
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
            axes.axis("off")
            axes.set_title(name, fontsize=6.5, pad=2)
            draw(axes, draw_moment(Moment.of_trace(trace, 0, 0), low))


if __name__ == "__main__":
    main()
