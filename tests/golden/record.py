"""Records what the shipped learned planners do: python tests/golden/record.py, after their weights have changed.

`states.npz` holds observations, the same for all planners; `<planner>.json` the outcome of each golden case and
the place of the command that is chosen in each of the states.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np

from crowdbench import Driver, Observation, Planner, load_planner, load_scenario, rollout
from crowdbench.planners.lookahead.planner import scene_of
from crowdbench.scenario.cases import Cases
from crowdbench.types import Outcome, Pedestrians, Vehicle

FOLDER = Path(__file__).parent
PLANNERS = ("cadrl", "lstm_rl", "sarl", "sarl_lin", "sarl_cvm", "sarl_sgan", "sarl_sgan_kce")
CASES = Cases("test", 0, 20)
SEVERAL_FUTURES = ("sarl_sgan", "sarl_sgan_kce")
"""Planners that take as many times as long, and of which a fifth of cases and states is recorded."""
EVERY = 6
"""Steps from one recorded state of an episode to the next."""


def outcomes(name):
    """How each golden case of a planner ends."""
    cases = Cases("test", 0, len(CASES) // 5) if name in SEVERAL_FUTURES else CASES
    trace = rollout(Driver(load_planner(name)[1], "golden"), load_scenario("circle_crossing_5"), cases)
    return [Outcome(outcome).label for outcome in trace.outcome]


def values(name):
    """What each command is worth to a planner in each of its golden states, [world, action]."""
    _, planner = load_planner(name)
    obs = read_states(FOLDER / "states.npz").take(slice(None, None, 5 if name in SEVERAL_FUTURES else 1))
    scene = scene_of(obs, planner.predictor.predict(obs, 1), 0, obs.vehicle)
    return planner.values(scene, planner.actions(obs.vehicle.preferred_speed))


class _Watching(Planner):
    """Another planner, whose observations are kept now and then."""

    privileged = True

    def __init__(self, planner):
        self.planner = planner
        self.seen = []

    def plan(self, obs):
        if obs.step[0] % EVERY == 0:
            self.seen.append(obs.take(slice(None)))
        return self.planner.plan(obs)


def write_states(path):
    """Drive `sarl_cvm` and keep what it sees."""
    watching = _Watching(load_planner("sarl_cvm")[1])
    rollout(Driver(watching, "golden"), load_scenario("circle_crossing_5"), CASES)
    arrays = {}
    for part, kind in {"": Observation, "vehicle.": Vehicle, "pedestrians.": Pedestrians}.items():
        for field in dataclasses.fields(kind):
            owners = [getattr(obs, part[:-1]) if part else obs for obs in watching.seen]
            found = [getattr(owner, field.name) for owner in owners]
            if all(isinstance(array, np.ndarray) for array in found):
                arrays[f"{part}{field.name}"] = np.concatenate(found)
    np.savez_compressed(path, dt=watching.seen[0].dt, **arrays)


def read_states(path):
    """The recorded states as one observation."""
    arrays = dict(np.load(path))
    dt = float(arrays.pop("dt"))
    parts = {
        part: {name.removeprefix(part): array for name, array in arrays.items() if name.startswith(part)}
        for part in ("vehicle.", "pedestrians.")
    }
    own = {name: array for name, array in arrays.items() if "." not in name}
    return Observation(
        vehicle=Vehicle(**parts["vehicle."]), pedestrians=Pedestrians(**parts["pedestrians."]), dt=dt, **own
    )


def main():
    write_states(FOLDER / "states.npz")
    for name in PLANNERS:
        golden = {"outcomes": outcomes(name), "chosen": values(name).argmax(axis=1).tolist()}
        (FOLDER / f"{name}.json").write_text(json.dumps(golden) + "\n")
        print(name, golden["outcomes"].count("success"), "successes")


if __name__ == "__main__":
    main()
