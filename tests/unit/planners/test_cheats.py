"""What a planner's author can try in order to see or to do more than a vehicle can."""

import gc
import inspect
import itertools

import numpy as np
import pytest
from helpers import Still, drive

from crowdbench.catalog import load_scenario
from crowdbench.core import rng
from crowdbench.core.types import World
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError

SECRET = 0x6A09E667F3BCC908 >> 1
"""A seed of 63 bits that the planner's author does not know."""

PUBLIC = "circle_crossing_5"


class Rebuilds(Planner):
    """Draws every public case from which an attack starts, and keeps the ones whose starts are those that it sees.

    Attributes:
        found: Number of worlds whose hidden goals it knows.
    """

    def __init__(self, guesses):
        self.guesses = guesses
        self.found = None

    def plan(self, obs):
        if self.found is None:
            worlds = self.guesses(obs)
            starts = {position.tobytes() for world in worlds for position in world.position[:, 1:]}
            self.found = sum(position.tobytes() in starts for position in obs.pedestrians.position)
        return np.zeros((len(obs), 2))


def from_rows(obs):
    """Taken for case numbers of the public scenario."""
    return [load_scenario(PUBLIC).draw(split, obs.row) for split in rng.SPLITS]


def from_cases(obs):
    """All cases that could be tried in the time of a decision, under the public seed and under CrowdNav's."""
    numbers = np.arange(40)
    by_seed = [load_scenario(PUBLIC, {"crowdnav_cases": cases}).draw("test", numbers) for cases in (0, 500)]
    return [*by_seed, load_scenario(PUBLIC).draw("val", numbers)]


def from_noise_keys(obs, monkeypatch):
    """The keys of the noise, taken for the keys of the cases."""
    with monkeypatch.context() as context:
        context.setattr(rng, "case_keys", lambda seed, split, cases: obs.noise_key)
        return [load_scenario(PUBLIC, {"crowdnav_cases": 0}).draw("test", obs.row)]


@pytest.mark.parametrize("attack", [from_rows, from_cases, from_noise_keys])
def test_under_a_secret_seed_no_world_is_rebuilt(attack, monkeypatch):
    guesses = attack if attack is not from_noise_keys else lambda obs: from_noise_keys(obs, monkeypatch)
    planner = Rebuilds(guesses)
    drive(planner, "40", seed=SECRET, crowdnav_cases=0)
    assert planner.found == 0


@pytest.mark.parametrize("attack", [from_rows, from_cases])
def test_under_a_public_seed_every_world_is_rebuilt(attack):
    planner = Rebuilds(attack)
    drive(planner, "40")
    assert planner.found == 40


def test_the_keys_of_noise_rebuild_nothing_under_a_public_seed_either(monkeypatch):
    planner = Rebuilds(lambda obs: from_noise_keys(obs, monkeypatch))
    drive(planner, "40", crowdnav_cases=0)
    assert planner.found == 0


def test_no_world_lies_behind_an_observation():
    class Digs(Still):
        reached = ()

        def plan(self, obs):
            known, new = {id(obs)}, [obs]
            while new:
                new = [one for one in gc.get_referents(*new) if id(one) not in known and not is_code(one)]
                known |= {id(one) for one in new}
                self.reached = (*self.reached, *map(type, new))
            return super().plan(obs)

    def is_code(one):
        return inspect.ismodule(one) or inspect.isclass(one) or inspect.isroutine(one)

    planner = Digs()
    rollout(Driver(planner, "digs"), load_scenario(PUBLIC), Cases("val", 0, 2), keep_logs=True)
    assert np.ndarray in planner.reached
    assert World not in planner.reached


def test_a_command_that_is_more_than_an_array_is_only_an_array():
    class Sly(np.ndarray):
        """Would put its own pedestrians into any array that it is joined with."""

        def __array_function__(self, function, types, args, kwargs):
            raise AssertionError("asked for more than its numbers")

        def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
            raise AssertionError("asked for more than its numbers")

    class Mine(Still):
        def plan(self, obs):
            return super().plan(obs).view(Sly)

    assert (drive(Mine(), "3").command[:, 0] == 0.0).all()


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of matrices
@pytest.mark.parametrize("make", [np.asmatrix, np.ma.masked_invalid])
def test_not_a_number_is_seen_in_any_kind_of_array(make):
    class Mine(Still):
        def plan(self, obs):
            return make(np.full((len(obs), 2), np.nan))

    with pytest.raises(InputError, match="command must be finite"):
        drive(Mine(), "3")


def test_a_command_cannot_be_changed_after_it_was_checked():
    class Mine(Planner):
        def __init__(self):
            self.mine = np.zeros((2, 2))

        def plan(self, obs):
            self.mine[: len(obs)] = 0.5
            return self.mine[: len(obs)]

    planner = Mine()
    driver = Driver(planner, "mine")
    start = load_scenario(PUBLIC).worlds(Cases("val", 0, 2))
    driver.reset(start.case)
    command = driver.decide(observe(start))
    planner.mine[:] = 99.0
    assert (command == 0.5).all()


def test_a_planner_cannot_become_privileged_on_the_way():
    class Late(Still):
        def plan(self, obs):
            type(self).privileged = True
            obs.true_next()
            return super().plan(obs)

    class Now(Still):
        asked = itertools.count()

        @property
        def privileged(self):
            return next(self.asked) > 0

    with pytest.raises(InputError, match=r"true_next\(\) shows what no vehicle sees"):
        drive(Late(), "2")
    with pytest.raises(InputError, match=r"true_next\(\) shows what no vehicle sees"):
        drive(type("Then", (Now,), {"plan": lambda self, obs: obs.true_next()})(), "2")


@pytest.mark.parametrize(
    ("attribute", "value", "match"),
    [
        ("privileged", "no", "has privileged = 'no', but it must be True or False"),
        ("raw", 1, "has raw = 1, but it must be True or False"),
        ("facts", {"weights": object()}, "has facts that a result cannot hold"),
        ("facts", {"score": float("nan")}, "has facts that a result cannot hold"),
        ("facts", 3, "has facts that a result cannot hold"),
    ],
)
def test_what_a_planner_says_of_itself_is_checked_before_it_drives(attribute, value, match):
    planner = Still()
    setattr(planner, attribute, value)
    with pytest.raises(InputError, match=match):
        Driver(planner, "mine")


def test_thinking_before_the_first_step_is_counted():
    class Thinks(Still):
        def reset(self, rows):
            sum(range(2_000_000))

    driver = Driver(Thinks(), "thinks")
    driver.reset(np.arange(2))
    assert driver.seconds > 1e-3


def test_a_seed_reaches_all_cases_or_is_refused():
    with pytest.raises(InputError, match="seed is 5, which changes no test case below crowdnav_cases = 500"):
        load_scenario(PUBLIC, {"seed": 5})
    cases = np.array([0, 499, 500])
    starts = [load_scenario(PUBLIC, {"seed": seed, "crowdnav_cases": 0}).draw("test", cases) for seed in (0, 5)]
    assert not (starts[0].position[:, 1:] == starts[1].position[:, 1:]).any()
