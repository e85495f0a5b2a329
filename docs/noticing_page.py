"""Prints docs/noticing.md, the reactions to the vehicle: python docs/noticing_page.py. docs/pictures.py draws it."""

import math
from pathlib import Path

import numpy as np

from crowdbench.api import rollout
from crowdbench.catalog import load_scenario, read_suite, scenarios
from crowdbench.core.geometry import norm
from crowdbench.core.types import Rules, Trace
from crowdbench.drawing import LIGHT, Disc, Moment, Polygon, Shape, draw_bands, draw_moment, extent
from crowdbench.figures.episode_figure import draw_pictures
from crowdbench.scenario.cases import Cases
from crowdbench.sim.attention import HALF_FIELD, LOOKS_AWAY, PERIOD, RANGE
from crowdbench.sim.lines_of_sight import share_to_walls
from crowdbench.utils.tables import printed_by

DOCS = Path(__file__).parent
SIDE = 2.4
"""The longer side of a picture in inches."""

REACH = 10.0
"""Largest distance in metres that a picture shows on each side of the vehicle."""

PLANNER, CASE = "orca_margin", Cases("val", 0, 1)

NOTE = f"""\
Pedestrians have [attention](pedestrians.md#cooperation-and-attention) where the scenario has a table
`[pedestrians.attention]`: they notice the vehicle in their field of view, {math.degrees(HALF_FIELD):.0f} degrees to
either side of the direction of walking, up to {RANGE:g} m and to the walls. Distracted pedestrians look away for
{LOOKS_AWAY:g} s in every {PERIOD:g} s.

The pictures are of case val/0, driven by `{PLANNER}`, at the time at which the numbers of pedestrians that have
noticed the vehicle (filled) and of those that have not (outlined) differ least. Yellow is the field of view of the
pedestrian nearest to the vehicle."""


def main() -> None:
    """Print the page."""
    described = dict(scenarios())
    source = f"{printed_by('python docs/noticing_page.py')} <!-- Do not edit this page: the command overwrites it. -->"
    print(f"# Reactions in each scenario\n\n{source}\n\n{NOTE}")
    print('\n<div class="gallery" markdown>')
    for name in suite_names():
        print(f"\n- **{name}**\n\n    ![Pedestrians that have noticed the vehicle in {name}](noticing/{name}.svg)")
        print(f"\n    {described[name]}. {sentence(load_scenario(name).rules)}")
    print("\n</div>")


def suite_names() -> list[str]:
    """Return the names of the scenarios of the suite."""
    suite = read_suite()
    return [*suite.ranked, *suite.stress, *suite.held_out]


def draw_noticing(name: str, out: Path) -> None:
    """Draw the state of the case of a scenario that `moment` returns."""
    trace = rollout(PLANNER, name, CASE)
    state = moment(trace)
    vehicle = trace.position[0, state, 0]
    low, high = extent(trace.position[0, :1], trace.goal[0, :1, 0], trace.obstacles[0], 0.7)
    plane = np.stack([np.maximum(low, vehicle - REACH), np.minimum(high, vehicle + REACH)])
    bands, bounds, inch = draw_bands(plane, SIDE)
    draw_pictures([([*shapes(trace, state), *bands], bounds, inch)], 1, out)


def sentence(rules: Rules) -> str:
    """Return a description of the reactions of pedestrians to the vehicle, from the rules of a scenario."""
    attention = rules.attention
    if not rules.visible:
        return "Non-cooperative: pedestrians do not see the vehicle."
    if attention is None:
        return "All pedestrians notice the vehicle, and avoid it as they avoid each other."
    shares = {
        "avoid it": 1.0 - attention.ignores - attention.yields_late - attention.attracted,
        "ignore it while it moves": attention.ignores,
        "yield late": attention.yields_late,
        "come to look at it": attention.attracted,
    }
    reactions = " and ".join(f"{100 * share:.0f} % {reaction}" for reaction, share in shares.items() if share > 0.0)
    return (
        f"Of the pedestrians with the vehicle in view for {attention.delay:g} s, {reactions}; "
        f"{100 * attention.distracted:.0f} % of all pedestrians are distracted."
    )


def moment(trace: Trace) -> int:
    """Return the state in which the numbers of pedestrians that have and have not noticed the vehicle differ least."""
    present = np.isfinite(trace.position[0, : trace.steps[0] + 1, 1:, 0])
    noticed = (have_noticed(trace)[: len(present)] & present).sum(axis=1)
    return int(np.argmin(np.abs(present.sum(axis=1) - 2 * noticed)))


def have_noticed(trace: Trace) -> np.ndarray:
    """Return which pedestrians have noticed the vehicle in each state of an episode, `[time, pedestrian]`."""
    everybody = np.full(trace.person[0].shape, trace.rules.visible)
    return everybody if trace.noticed is None else trace.noticed[0]


def shapes(trace: Trace, state: int) -> list[Shape]:
    """Return the picture of a state. Filled pedestrians have noticed the vehicle, outlined ones have not."""
    people, drawn = trace.position[0, state, 1:], list[Shape]()
    here = np.flatnonzero(np.isfinite(people[:, 0]))
    if trace.noticed is not None:
        nearest = here[np.argmin(norm(people[here] - trace.position[0, state, 0]))]
        drawn.append(field_of_view(people[nearest], trace.velocity[0, state, 1 + nearest], trace.obstacles[0]))
    drawn += draw_moment(Moment.of_trace(trace, 0, state))
    for person in here[~have_noticed(trace)[state, here]]:
        radius = float(trace.radius[0, state, 1 + person])
        drawn.append(Disc(people[person], radius, LIGHT.background, LIGHT.pedestrian, 1.0))
    return drawn


def field_of_view(position: np.ndarray, velocity: np.ndarray, obstacles: np.ndarray) -> Polygon:
    """Return the field of view, up to the walls, of a pedestrian that walks with a velocity."""
    angles = math.atan2(velocity[1], velocity[0]) + np.linspace(-HALF_FIELD, HALF_FIELD, 121)
    rays = RANGE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if len(obstacles):
        rays *= np.array([share_to_walls(*position, *ray, obstacles) for ray in rays])[:, None]
    return Polygon(np.vstack([position, position + rays]), (255, 243, 200), (255, 243, 200), 0.0)


if __name__ == "__main__":
    main()
