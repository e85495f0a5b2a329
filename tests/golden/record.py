"""Records what the shipped learned planners decide: python tests/golden/record.py, after their weights have changed.

`states.npz` holds observations, the same for all planners. `<planner>.json` holds the outcome of each golden case, and
the command that is decided in each of the states: after shortlist, limits and exploration, where there are any. They
hold for the version of the simulator and for the digest of `circle_crossing_5` in `episodes.json`.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np

from crowdbench import Observation, Planner, load_planner, load_scenario, rollout
from crowdbench.core.types import Outcome, Pedestrians, Vehicle
from crowdbench.planners.scene import scene_of
from crowdbench.runs.spec import EVERY_STEP, Replanning
from crowdbench.scenario.cases import Cases

FOLDER = Path(__file__).parent
PLANNERS = ("cadrl", "lstm_rl", "sarl", "sarl_lin", "sarl_cvm", "sarl_sgan", "sarl_sgan_kce", "sarl_sgan_kce_bounded")
CASES = Cases("test", 0, 20)
SEVERAL_FUTURES = ("sarl_sgan", "sarl_sgan_kce", "sarl_sgan_kce_bounded")
"""Planners that take many times as long: fewer of the cases and states are recorded of them."""
POLICY = "ppo"
"""A planner without values: its commands themselves are compared."""
SEQUENCES = "sarl_sgan_seq"
"""A planner that is recorded by its outcomes alone, with eight commands per observation."""
COLLISIONS = {"cadrl": 110, "lstm_rl": 142, "sarl_lin": 52, "sarl_sgan_kce": 316, "ppo": 310}
"""Test cases in which planners collide, so that not all recorded outcomes are successes. The others never do."""
EVERY = 6
"""Steps from one recorded state of an episode to the next."""
FIRST_CHANGE = 1
"""A step that is recorded too: it is the first at which pedestrians are seen to move, and commands change much."""


def outcomes(name):
    """How each golden case of a planner ends."""
    planner, scenario = load_planner(name), load_scenario("circle_crossing_5")
    first = Cases("test", 0, len(CASES) // 5) if name in (*SEVERAL_FUTURES, SEQUENCES) else CASES
    replanning = Replanning(8) if name == SEQUENCES else EVERY_STEP
    hard = [Cases("test", case, case + 1) for planner, case in COLLISIONS.items() if planner == name]
    traces = [rollout(planner, scenario, cases, replanning=replanning) for cases in (first, *hard)]
    return [Outcome(outcome).label for trace in traces for outcome in trace.outcome]


def states_of(name):
    """The states that are recorded of a planner.

    All, or where it has several futures, those of every third case and those of the first change.
    """
    states = read_states(FOLDER / "states.npz")
    few = (states.row % 3 == 0) | (states.step == FIRST_CHANGE)
    return states.take(few) if name in SEVERAL_FUTURES else states


def losses(planner, states, commands):
    """How much the values of other commands [state, 2] differ from those of the decided ones, to a planner: [state].

    Infinite for a command that the planner's limits do not allow.
    """
    scene = scene_of(states, planner.predictor.predict(states, 1), 0, states.vehicle)
    values = planner.score(scene, np.stack([planner.choose(scene).best(), commands], axis=1)).values
    return np.abs(values[:, 0] - values[:, 1])


class _Watching(Planner):
    """Another planner, whose observations are kept now and then."""

    privileged = True

    def __init__(self, planner):
        self.planner = planner
        self.seen = []

    def plan(self, obs):
        if obs.step[0] % EVERY == 0 or obs.step[0] == FIRST_CHANGE:
            self.seen.append(obs.take(slice(None)))
        return self.planner.plan(obs)


PARTS = {"": Observation, "vehicle.": Vehicle, "pedestrians.": Pedestrians}
"""What an observation consists of, by the prefix of its arrays' names in the file."""


def write_states(path):
    """Drive `sarl_cvm` and keep what it sees."""
    watching = _Watching(load_planner("sarl_cvm"))
    rollout(watching, "circle_crossing_5", CASES)
    arrays = {}
    for part, kind in PARTS.items():
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
    for name in (*PLANNERS, POLICY, SEQUENCES):
        golden = {"outcomes": outcomes(name)}
        if name != SEQUENCES:
            golden["commands"] = load_planner(name).plan(states_of(name)).tolist()
        (FOLDER / f"{name}.json").write_text(json.dumps(golden) + "\n")
        print(name, {label: golden["outcomes"].count(label) for label in golden["outcomes"]})


if __name__ == "__main__":
    main()
