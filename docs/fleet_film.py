"""Draws the film of the page on several vehicles, an animated SVG: four planners in one world."""

from pathlib import Path

import numpy as np

from crowdbench import Observation, Planner, Trace, load_planner, rollout
from crowdbench.drawing import DARK, LIGHT, Palette

NAMES = ("mppi", "ppo_attention", "sarl_cvm", "orca")
SCENARIO, CASE = "fleet_4", 3

SPEED, HOLD = 2.0, 2.0
"""Seconds of the episode per second of the film, and seconds of the film that show the end."""

HALF, WIDTH = 6.6, 420
"""Half the side of the shown square in metres, and its side in pixels."""


class Team(Planner):
    """Four planners: each drives the vehicle of its number in every world."""

    def __init__(self) -> None:
        self.planners = [load_planner(name) for name in NAMES]

    def reset(self, cases: np.ndarray) -> None:
        """Reset all planners."""
        for planner in self.planners:
            planner.reset(cases)

    def plan(self, obs: Observation) -> np.ndarray:
        """Return the command of each vehicle by its planner."""
        commands = np.zeros((len(obs), 2))
        for number, planner in enumerate(self.planners):
            chosen = obs.row % len(NAMES) == number
            if chosen.any():
                commands[chosen] = planner.plan(obs.take(chosen))
        return commands


def draw_fleet(out: Path) -> None:
    """Draw four planners that exchange places among twelve pedestrians."""
    trace = rollout(Team(), SCENARIO, f"test/{CASE}", undisturbed=False)
    last = int(trace.steps.argmax())  # the vehicle that arrives last sees the whole episode
    vehicles = [draw_agent(trace, row, 0, name) for row, name in enumerate(NAMES)]
    pedestrians = [draw_agent(trace, last, agent) for agent in range(len(NAMES), trace.radius.shape[2])]
    goals = [
        f'<circle cx="{x:.2f}" cy="{-y:.2f}" r="{radius:.2f}" class="goal"/>'
        for (x, y), radius in zip(trace.goal[:, 0, 0], trace.radius[:, 0, 0], strict=True)
    ]
    box = f"{-HALF} {-HALF} {2 * HALF} {2 * HALF}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="{WIDTH}" height="{WIDTH}">'
    title = f"<title>{', '.join(NAMES)} exchange places among twelve pedestrians</title>"
    dark = f"@media (prefers-color-scheme: dark){{{style(DARK)}}}"
    parts = [head, title, f"<style>{style(LIGHT)}{dark}</style>", *goals, *pedestrians, *vehicles, "</svg>"]
    out.write_text("\n".join(parts) + "\n")


def draw_agent(trace: Trace, row: int, agent: int, name: str = "") -> str:
    """Return an agent that moves as in an episode, until it has arrived, with a name above it."""
    steps, shown = int(trace.steps.max()), int(trace.steps[row])
    position, present = trace.position[row, : shown + 1, agent], trace.present[row, : shown + 1, agent]
    there = np.flatnonzero(present)
    path = [position[min(step, there[-1])] for step in range(steps + 1)]
    hold = round(HOLD * SPEED / trace.rules.dt)
    places = ";".join(f"{x:.2f} {-y:.2f}" for x, y in [*path, *[path[-1]] * hold])
    seconds = (steps + hold) * trace.rules.dt / SPEED
    length = f'dur="{seconds:g}s" repeatCount="indefinite"'
    leaves = "" if there[-1] == steps else _fade(float(there[-1]) / (steps + hold), length)
    label = f'<text y="{-trace.radius[row, 0, agent] - 0.15:.2f}">{name}</text>' if name else ""
    return (
        f'<g class="{"vehicle" if name else "pedestrian"}">'
        f'<animateTransform attributeName="transform" type="translate" values="{places}" {length}/>{leaves}'
        f'<circle r="{trace.radius[row, 0, agent]:.2f}"/>{label}</g>'
    )


def _fade(share: float, length: str) -> str:
    """Return the animation of an agent that leaves after a share of the film."""
    times = f'keyTimes="0;{share:.3f}" calcMode="discrete"'
    return f'<animate attributeName="opacity" values="1;0.15" {times} {length}/>'


def style(palette: Palette) -> str:
    """Return the colours of the film in a theme."""
    vehicle, pedestrian, text = (
        f"#{bytes(part).hex()}" for part in (palette.vehicle, palette.pedestrian, palette.text)
    )
    return (
        f".vehicle circle{{fill:{vehicle}}}.pedestrian circle{{fill:{pedestrian}}}"
        f".goal{{fill:none;stroke:{vehicle};stroke-width:.05}}"
        f"text{{fill:{text};font:.42px sans-serif;text-anchor:middle}}"
    )
