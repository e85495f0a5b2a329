"""Draws docs/faults.png, a collision of each kind: python docs/faults_figure.py."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Trace
from crowdbench.drawing import LIGHT, Line, Moment, draw_moment
from crowdbench.figures.style import canvas, draw
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.contacts import WINDOW, Fault, find_contacts

RUNS, CASES = (("sarl_cvm", "car_12"), ("straight", "groups_12")), Cases("test", 0, 200)
"""The first collision of each kind in these is drawn."""

KINDS = {
    Fault.STRUCK_STANDING: "struck standing",
    Fault.STRUCK_BEHIND: "struck from behind",
    Fault.STRUCK: "struck otherwise",
    Fault.ALONE: "hit alone",
    Fault.BOTH: "hit both",
    Fault.UNDETERMINED: "undetermined",
}
REACH = 3.0
"""Metres that a panel shows on each side of the vehicle."""


def main() -> None:
    """Write the figure."""
    shown = {}
    for planner, scenario in RUNS:
        trace = rollout(Driver(load_planner(planner)[1], planner), load_scenario(scenario), CASES)
        contacts = find_contacts(trace)
        for kind in KINDS:
            rows = np.flatnonzero((contacts.fault == kind) & (contacts.agent > 0))
            if len(rows) and kind not in shown:
                shown[kind] = trace, int(rows[0]), contacts, f"{planner}, {scenario}"
    with canvas(Path(__file__).with_name("faults.png"), 1.9 * len(shown), 2.4) as figure:
        for place, kind in enumerate(sorted(shown), start=1):
            trace, row, contacts, run = shown[kind]
            axes = figure.add_subplot(1, len(shown), place)
            share = f"{contacts.share[row]:.2g}" if np.isfinite(contacts.share[row]) else "none"
            axes.set_title(f"{KINDS[kind]}, φ {share}\n{run}, case {trace.case[row]}", fontsize=6.5, pad=2)
            draw_contact(axes, trace, row, int(contacts.agent[row]))


def draw_contact(axes: Axes, trace: Trace, row: int, agent: int) -> None:
    """The end of an episode around the vehicle, with the ways of the last second."""
    steps = int(trace.steps[row])
    middle = trace.position[row, steps, 0]
    low, high = middle - REACH, middle + REACH
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.axis("off")
    states = slice(max(0, steps - round(WINDOW / trace.rules.dt)), steps + 1)
    ways = [Line(trace.position[row, states, who], LIGHT.contact, 1.5) for who in (0, agent)]
    draw(axes, [*draw_moment(Moment.of_trace(trace, row, steps)), *ways])


if __name__ == "__main__":
    main()
