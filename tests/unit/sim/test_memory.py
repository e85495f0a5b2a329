"""Pedestrian policies with a memory, which the worlds carry."""

import dataclasses

import numpy as np
import pytest
from checks import policy_faults
from helpers import drive, same

from crowdbench.catalog import load_scenario
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.planners.driver import Driver
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import PolicyWithMemory
from crowdbench.sim.simulator import crowd_decisions, step
from crowdbench.utils.errors import InputError

FILE = """
import dataclasses

import numpy as np
from crowdbench import PolicyWithMemory


class Tired(PolicyWithMemory):
    parameters = {"rest": 0.25}

    def memory(self, world, parameters):
        return {"walked": np.zeros(world.radius[:, 1:].shape)}

    def velocities(self, world, parameters, memory):
        way = world.goal[:, 1:] - world.position[:, 1:]
        velocity = way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1.0)
        velocity *= np.where(memory["walked"] > 1.0, parameters["rest"][:, 1:], 1.0)[..., None]
        return velocity, {"walked": memory["walked"] + np.linalg.norm(velocity, axis=2) * world.rules.dt}


def policy():
    return Tired()
"""


@pytest.fixture
def tired(tmp_path):
    path = tmp_path / "tired.py"
    path.write_text(FILE)
    return str(path)


def walked(world):
    return world.memory["tired"]["walked"]


def test_the_world_carries_what_a_policy_remembers(tired):
    place = load_scenario("circle_crossing_5", pedestrians=tired)
    world = place.worlds(Cases.parse("3"))
    assert walked(world).tolist() == [[0.0] * 5] * 3
    for _ in range(6):
        crowd, decided = crowd_decisions(world, place.policies)
        assert np.linalg.norm(crowd, axis=2) == pytest.approx(np.where(walked(world) > 1.0, 0.25, 1.0))
        world, _ = step(decided, np.zeros((3, 2)), crowd)
    assert walked(world) == pytest.approx(1.25 + 0.0625)
    assert np.array_equal(walked(world.take(np.array([2]))), walked(world)[[2]])


def test_a_case_with_memories_is_the_same_alone_and_in_a_batch(tired):
    place = load_scenario("circle_crossing_mixed", pedestrians=tired)

    def driven(cases):
        return rollout(Driver(ORCAPlanner(), "orca"), place, Cases.parse(cases))

    together = driven("6")
    for case in range(6):
        steps = together.steps[case] + 1
        alone = driven(f"{case}:{case + 1}")
        assert np.array_equal(alone.position[0, :steps], together.position[case, :steps], equal_nan=True)
    assert same(together, driven("6"))


def test_environments_carry_memories(tired):
    place = load_scenario("circle_crossing_5", pedestrians=tired)
    world = place.worlds(Cases.parse("1"))
    many, one = VehicleVectorEnv(2, place), parallel_env(place)
    many.reset(options={"case": ["test/0", "test/0"]})
    one.reset(options={"case": "test/0"})
    for _ in range(6):
        crowd, world = crowd_decisions(world, place.policies)
        world, _ = step(world, np.zeros((1, 2)), crowd)
        many.step(np.zeros((2, 2)))
        one.step({"vehicle": np.zeros(2)})
    for held in (many._worlds, one._world):
        assert np.array_equal(walked(held)[0], walked(world)[0])
        assert np.array_equal(held.position[0], world.position[0])


def test_the_policy_of_a_pedestrian_that_acts_sees_the_step_too(tired):
    env = parallel_env(load_scenario("circle_crossing_5", pedestrians=tired))
    env.reset(seed=0)
    env.step({agent: np.zeros(2) for agent in env.agents})
    assert walked(env._world) == pytest.approx(0.25)


def test_replays_drive_with_memories(tired):
    trace = drive("orca", "3", "circle_crossing_5_visible", pedestrians__policy=tired)
    assert (trace.undisturbed[:, 1] != trace.undisturbed[:, 0]).any()


class Remembers(PolicyWithMemory):
    """Walks to the goal and remembers the last velocity, unless it is told to do something else in step 2."""

    def __init__(self, change=lambda velocity, memory, world: (velocity, memory), first=None):
        self.change, self.first = change, first

    def memory(self, world, parameters):
        return {"last": np.zeros(world.position[:, 1:].shape)} if self.first is None else self.first(world)

    def velocities(self, world, parameters, memory):
        velocity = world.goal[:, 1:] - world.position[:, 1:] + 0.5 * memory["last"]
        answer = velocity, {"last": velocity * world.present[:, 1:, None]}
        return self.change(*answer, world) if world.step[0] == 2 else answer


def slower_alone(velocity, memory, world):
    return velocity, {"last": memory["last"] * (0.5 if len(world) == 1 else 1.0)}


def meddling(velocity, memory, world):
    world.memory["orca"]["last"][0, 0] = 9.0
    return velocity, memory


OFFENCES = {
    "another name": (lambda v, m, w: (v, {"first": m["last"]}), "answers", "returned float64 of shape"),
    "another type": (lambda v, m, w: (v, {"last": m["last"].astype(int)}), "answers", "returned int64 of shape"),
    "a list": (lambda v, m, w: (v, {"last": m["last"].tolist()}), "answers", "not an array"),
    "no memory": (lambda v, m, w: v, "answers", "not a tuple of velocities and memory"),
    "changed in place": (meddling, "answers", "changes world.memory['orca']['last'] (case 0, step 2"),
    "another memory alone": (slower_alone, "independent", "velocities differ when a case is driven alone"),
}


@pytest.mark.parametrize("name", OFFENCES)
def test_a_fault_of_a_memory_is_found(name):
    change, check, expected = OFFENCES[name]
    faults = policy_faults(lambda: Remembers(change))
    assert set(faults) == {check}
    assert expected in faults[check]


def wide(world):
    return {"last": np.full(world.position[:, 1:].shape, 1.0 if world.position.shape[1] > 11 else 0.0)}


def one_row(world):
    return {"last": np.zeros((1, world.position.shape[1] - 1, 2))}


def test_a_memory_that_padding_changes_or_without_worlds_is_found():
    assert "with 3 more absent pedestrians" in policy_faults(lambda: Remembers(first=wide))["independent"]
    with pytest.raises(InputError, match="for 5 worlds, but the first axis must be the worlds"):
        policy_faults(lambda: Remembers(first=one_row))


def test_a_policy_with_memory_passes():
    assert not policy_faults(Remembers)


def test_a_bad_memory_gets_one_sentence(tmp_path):
    path = tmp_path / "forgetful.py"
    path.write_text(FILE.replace('{"walked": memory', '{"miles": memory'))
    place = load_scenario("circle_crossing_5", pedestrians=str(path))
    with pytest.raises(InputError, match=r"returned float64 of shape \(1, 5\) as memory\['miles'\], which was nothing"):
        crowd_decisions(place.worlds(Cases.parse("1")), place.policies)


class Shy(PolicyWithMemory):
    """Walks to the goal, more slowly the nearer somebody was at the start."""

    def memory(self, world, parameters):
        distance = np.linalg.norm(world.position[:, None] - world.position[:, 1:, None], axis=3)
        away = np.where(world.present[:, None], distance, np.inf)
        away[:, np.arange(away.shape[1]), np.arange(1, away.shape[1] + 1)] = np.inf
        return {"pace": np.clip(away.min(axis=2) / 4.0, 0.1, 1.0)}

    def velocities(self, world, parameters, memory):
        way = world.goal[:, 1:] - world.position[:, 1:]
        velocity = way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1.0)
        return velocity * memory["pace"][..., None], memory


@pytest.mark.parametrize("attention", [{}, {"pedestrians.attention": {"delay": 0.0}}])
def test_the_undisturbed_crowd_remembers_nothing_of_the_vehicle(attention):
    def driven(**vehicle):
        place = load_scenario("circle_crossing_5", vehicle)
        shy = dataclasses.replace(place, policies={"orca": Shy()})
        return rollout(Driver(ORCAPlanner(), "orca"), shy, Cases.parse("20"))

    seen = driven(**{"vehicle.visible": True, **attention})
    unseen = driven(**{"vehicle.visible": False})
    assert not np.array_equal(seen.position[:, 4, 1:], unseen.position[:, 4, 1:])
    for w in range(20):
        both = min(seen.steps[w], unseen.steps[w]) + 1
        assert np.array_equal(seen.undisturbed[w, :both], unseen.position[w, :both, 1:])
