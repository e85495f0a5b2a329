"""`[pedestrians.population]`: people who differ, and whose intentions have noise and inertia."""

import json
import math

import numpy as np
import pytest
from helpers import Still, drive, fixture, same, world

from crowdbench.catalog import load_scenario
from crowdbench.core.geometry import norm, toward_goal
from crowdbench.core.types import Intention, Rules
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.scenario.cases import Cases
from crowdbench.sim import kernels
from crowdbench.sim.intention import FASTEST, SLOWEST, IntentionState
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.simulator import INTENTION, crowd_decisions, init_memories, limit_velocities, step_pedestrians
from crowdbench.utils.errors import InputError

DT = 0.25
FITTED = {"noise": 0.15, "noise_time": 1.4, "inertia": 2.7}
VARIED = {"shrinkage": 0.4, "spread": {"radius": 0.1, "preferred_speed": 0.2, "time_horizon": 0.4}}
KEY, SCENARIO = "pedestrians.population", "circle_20_blind"


def scene(intention, position, goal, velocity=None, policy=None, **changes):
    """Worlds of pedestrians who walk by ORCA, or by another policy, without a vehicle in their way."""
    rules = Rules(dt=DT, intentions=(intention,))
    start = world([[0.0, 99.0], *position], velocity and [[0.0, 0.0], *velocity], [[0.0, 99.0], *goal], rules=rules)
    policies = {"orca": policy or ORCA()}
    return init_memories(start.replace(**changes), policies), policies


def walk(now, policies, steps):
    """Yield the decisions, and the worlds in which they were made with the memory after them."""
    for _ in range(steps):
        crowd, now = crowd_decisions(now, policies)
        yield crowd, now
        now = step_pedestrians(now, crowd, None)


def intended(now):
    return now.memory[INTENTION]["velocity"]


def far_walkers(intention, people=300, steps=160, speed=1.3):
    """The intended velocities `[time, pedestrian, 2]` of people whose goals are far away along x."""
    y = 9.0 * np.arange(people)
    position, goal = np.column_stack([0.0 * y, y]), np.column_stack([0.0 * y + 1e5, y])
    now, policies = scene(intention, position, goal, preferred_speed=np.full((1, people + 1), speed))
    now = now.replace(key=np.array([7], np.uint64))
    return np.array([intended(after)[0] for _, after in walk(now, policies, steps)])


# The process.


@pytest.mark.parametrize("noise_time", [0.5, 1.4])
def test_noise_has_its_deviation_and_correlation_from_the_start(noise_time):
    velocity = far_walkers(Intention(0.2, noise_time))
    deviation = (velocity - [1.3, 0.0]) / 1.3
    assert deviation[0].std(axis=0) == pytest.approx([0.2, 0.2], rel=0.15)
    assert deviation.std(axis=(0, 1)) == pytest.approx([0.2, 0.2], rel=0.03)
    for lag in (1, 4):
        correlation = (deviation[lag:] * deviation[:-lag]).mean(axis=(0, 1)) / deviation.var(axis=(0, 1))
        assert correlation == pytest.approx([math.exp(-lag * DT / noise_time)] * 2, abs=0.04)
    assert abs((deviation[..., 0] * deviation[..., 1]).mean()) < 0.002
    assert abs(np.corrcoef(deviation[:, 0].T, deviation[:, 1].T)[0, 1]) < 0.4


def test_inertia_filters_the_noise():
    deviation = (far_walkers(Intention(0.2, 1.4, 2.7))[60:] - [1.3, 0.0]) / 1.3
    keep, gain = math.exp(-DT / 1.4), 1.0 - math.exp(-DT / 2.7)
    expected = 0.2 * math.sqrt(gain / (2.0 - gain) * (1.0 + (1.0 - gain) * keep) / (1.0 - (1.0 - gain) * keep))
    assert expected == pytest.approx(0.2 * math.sqrt(1.4 / (1.4 + 2.7)), rel=0.1)
    assert deviation.std(axis=(0, 1)) == pytest.approx([expected] * 2, rel=0.05)


def test_inertia_is_a_relaxation_from_the_initial_velocity():
    now, policies = scene(
        Intention(0.0, 1.0, 2.0), [[0.0, 0.0], [0.0, 50.0]], [[1e4, 0.0], [1e4, 50.0]], [[0, 0.8], [0, 0]]
    )
    found = np.array([intended(after)[0] for _, after in walk(now, policies, 12)])
    decay = np.exp(-DT * np.arange(1, 13) / 2.0)
    assert found[:, 0] == pytest.approx(np.column_stack([1.0 - decay, 0.8 * decay]), abs=1e-2)  # it moves off the line
    assert found[:, 1] == pytest.approx(np.tile([1.0, 0.0], (12, 1)), abs=1e-12)  # from rest: as desired at once


def test_near_the_goal_the_intention_relaxes_in_the_time_that_is_left():
    now, policies = scene(Intention(0.0, 1.0, 9.0), [[0.0, 0.0]], [[0.0, 2.0]], [[1.0, 0.0]])
    _, after = next(walk(now, policies, 1))
    assert intended(after)[0, 0] == pytest.approx([math.exp(-DT / 2.0), 1.0 - math.exp(-DT / 2.0)])


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["straight", "orca", "social_force", "power_law"])
def test_everybody_still_arrives(policy):
    changes = {KEY: FITTED, "pedestrians.number": 4, "pedestrians.policy": policy}
    scenario = load_scenario(SCENARIO, changes | {"pedestrians.limits": None})
    now = scenario.worlds(Cases.parse("val:10"))
    for _ in range(120):
        crowd, now = crowd_decisions(now, scenario.policies)
        now = step_pedestrians(now, crowd, scenario.post_step_rule)
    assert now.present[:, 1:].sum() == 0


def test_who_stops_stands_still():
    now, policies = scene(Intention(0.3, 1.0, 2.0), [[0.0, 0.0]], [[9.0, 0.0]], [[1.0, 0.0]])
    now = now.replace(preferred_speed=np.array([[1.0, 0.0]]))
    for crowd, _ in walk(now, policies, 3):
        assert not crowd.any()


# Policies.


class Seen(ORCA):
    """A policy that remembers the world in which it was queried."""

    def velocities(self, world, parameters):
        self.world = world
        return toward_goal(world.position, world.goal, world.preferred_speed)[:, 1:]


def test_the_policy_is_shown_the_intended_velocity_and_true_goals_stay():
    policy = Seen()
    position, goal = [[0.0, 0.0], [0.0, 9.0], [0.0, 18.0]], [[20.0, 0.0], [1.5, 9.0], [0.2, 18.0]]
    now, policies = scene(Intention(0.3, 1.0, 2.0), position, goal, [[0.0, 1.1], [0.1, 0.1], [0.0, 0.0]], policy)
    for crowd, after in walk(now, policies, 8):
        want = intended(after)
        assert crowd == pytest.approx(want, abs=1e-12)
        shown, speed = policy.world, np.linalg.norm(want, axis=2)
        assert shown.preferred_speed[:, 1:] == pytest.approx(np.maximum(speed, SLOWEST))
        far = norm(shown.goal - shown.position)[0, 1:]
        to_goal = norm(after.goal - after.position)[0, 1:]
        quick = speed[0] > SLOWEST
        assert far[quick] == pytest.approx(np.maximum(to_goal, 2.0 * speed[0])[quick])
        assert far[~quick] == pytest.approx(speed[0][~quick])
        assert np.array_equal(after.goal, now.goal)
        assert np.array_equal(after.preferred_speed, now.preferred_speed)
    assert quick.any()
    assert not quick.all()


def test_what_people_intend_above_their_preferred_speed_is_walked():
    now, policies = scene(Intention(0.3, 1.0), [[0.0, 0.0]], [[1e4, 0.0]], policy=Seen())
    now, speeds = now.replace(key=np.array([3], np.uint64)), []
    for crowd, after in walk(now, policies, 60):
        assert limit_velocities(after, crowd) == pytest.approx(crowd, abs=1e-12)
        speeds.append(np.linalg.norm(crowd))
    assert 1.1 < max(speeds) <= FASTEST
    assert np.mean(speeds) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("inertia", [0.5, 3.0])
def test_avoidance_is_not_smoothed(inertia):
    """Two pairs of people who meet head-on, and one with a slight offset, do not overlap."""
    for offset in (0.0, 0.05, 0.3):
        now, policies = scene(
            Intention(0.0, 1.0, inertia),
            [[-3.0, offset], [3.0, 0.0]],
            [[9.0, offset], [-9.0, 0.0]],
            [[1.0, 0.0], [-1.0, 0.0]],
        )
        gaps = [math.dist(after.position[0, 1], after.position[0, 2]) - 0.6 for _, after in walk(now, policies, 40)]
        assert min(gaps) > -1e-6
        assert now.position[0, 1, 0] < 0.0 < after_crossing(now, policies)


def after_crossing(now, policies):
    """The distance by which both have passed each other."""
    *_, (_, after) = walk(now, policies, 40)
    return after.position[0, 1, 0] - after.position[0, 2, 0]


@pytest.mark.parametrize("policy", ["orca", "social_force", "power_law", "stop_and_go", "straight", "learned", "file"])
def test_every_policy_takes_one_and_keeps_the_limits(policy, tmp_path):
    if policy == "file":
        path = tmp_path / "mine.py"
        path.write_text(
            "from crowdbench import PedestrianPolicy\n\n\nclass Mine(PedestrianPolicy):\n"
            "    def velocities(self, world, parameters):\n        return (world.goal - world.position)[:, 1:]\n\n\n"
            "def policy():\n    return Mine()\n"
        )
        policy = str(path)
    limits = {"acceleration": 0.5, "braking": 1.0, "sideways": 0.7}
    changes = {"pedestrians__policy": policy, "vehicle__visible": True, "pedestrians__limits": limits}
    without = drive(Still(), "val:3", SCENARIO, **changes)
    trace = drive(Still(), "val:3", SCENARIO, **changes, pedestrians__population=FITTED)
    assert not np.array_equal(trace.position, without.position)
    for velocity in (trace.velocity, np.diff(trace.undisturbed, axis=1) / DT):
        assert np.nanmax(np.linalg.norm(np.diff(velocity, axis=1), axis=-1)) / DT <= 1.0 + 1e-9


def test_a_policy_brings_its_own_population(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "from crowdbench import ORCA\n\n\nclass Own(ORCA):\n"
        '    population = {"noise": 0.2, "spread": {"time_horizon": 0.3}}\n\n\ndef policy():\n    return Own()\n'
    )
    shares = {"pedestrians.policy": {"orca": 0.5, str(path): 0.5}}
    scenario = load_scenario(SCENARIO, shares)
    assert scenario.rules.intentions == (Intention(), Intention(0.2), Intention())  # orca, own, recorded people
    assert scenario.table["pedestrians"]["own"]["population"]["noise"] == 0.2
    now = scenario.worlds(Cases.parse("val:4"))
    assert len(np.unique(now.parameters["own"]["time_horizon"][:, 1:])) == 80
    assert len(np.unique(now.parameters["orca"]["time_horizon"][:, 1:])) == 1
    _, after = crowd_decisions(now, scenario.policies)
    assert np.array_equal(after.memory[INTENTION]["person"] >= 0, now.policy == 1)
    both = load_scenario(SCENARIO, shares | {KEY: {"inertia": 1.0}, "pedestrians.own": {"population": {"noise": 0.1}}})
    assert both.rules.intentions == (Intention(0.0, 1.0, 1.0), Intention(0.1), Intention())
    assert both.table["pedestrians"]["own"]["population"]["spread"] == {"time_horizon": 0.3}
    assert len({scenario.digest, both.digest, load_scenario(SCENARIO, shares | {KEY: {"inertia": 1.0}}).digest}) == 3


@pytest.mark.parametrize(
    ("population", "words"),
    [
        ({"noize": 0.1}, "pedestrian policy own: unknown key population.noize (did you mean noise?)"),
        ({"noise": -1.0}, "pedestrian policy own: population.noise is -1.0, but must be a number of at least 0"),
        (0.3, "population of pedestrian policy own is 0.3, but must be a table"),
        ({"spread": {"pace": 0.1}}, "pedestrians.own.population.spread is a table with pace, but must be of"),
    ],
)
def test_a_bad_population_of_a_policy_gets_one_sentence(population, words, tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        f"from crowdbench import ORCA\n\n\nclass Own(ORCA):\n    population = {population!r}\n\n\n"
        "def policy():\n    return Own()\n"
    )
    with pytest.raises(InputError) as error:
        load_scenario(SCENARIO, {"pedestrians.policy": str(path)})
    assert words in str(error.value)


def test_standing_people_have_none():
    shares = {"pedestrians.policy": {"standing": 0.5, "social_force": 0.5}, "pedestrians.clear_space": None}
    rules = load_scenario("circle_crossing_10", shares | {KEY: FITTED}).rules
    assert rules.intentions == (Intention(0.15, 1.4, 2.7), Intention(), Intention())


# Draws.


def draw(changes, cases="val:40", scenario=SCENARIO):
    return load_scenario(scenario, changes).worlds(Cases.parse(cases))


@pytest.mark.slow
def test_people_differ_by_factors_around_the_same_draws():
    uniform = {"pedestrians.preferred_speed": {"low": 0.6, "high": 1.4}}
    plain, varied = draw(uniform), draw(uniform | {KEY: VARIED})
    factors = {
        "radius": varied.radius / plain.radius,
        "preferred_speed": varied.preferred_speed / (plain.preferred_speed + 0.4 * (1.2 - plain.preferred_speed)),
        "time_horizon": varied.parameters["orca"]["time_horizon"] / plain.parameters["orca"]["time_horizon"].max(),
    }
    logs = {name: np.log(factor[:, 1:]).ravel() for name, factor in factors.items()}
    for name, found in logs.items():
        sigma = VARIED["spread"][name]
        assert np.abs(found).max() <= 2.0 * sigma + 1e-9
        assert found.std() == pytest.approx(0.88 * sigma, rel=0.06)  # of a normal number within two deviations
        assert abs(np.median(found)) < 0.1 * sigma
    assert np.abs(np.corrcoef(list(logs.values())) - np.eye(3)).max() < 0.1
    assert (varied.radius[:, 0] == 0.3).all()
    assert np.array_equal(plain.parameters["orca"]["max_neighbors"], varied.parameters["orca"]["max_neighbors"])


def test_mixed_crowds_vary_in_the_parameters_of_each_policy():
    spread = {"time_horizon": 0.3, "relaxation_time": 0.3}
    now = draw({KEY: {**FITTED, "spread": spread}, "pedestrians.number": 20}, "val:3", "mixed")
    orca, force = now.parameters["orca"], now.parameters["social_force"]
    assert len(np.unique(orca["time_horizon"][:, 1:])) == len(np.unique(force["relaxation_time"][:, 1:])) == 60
    assert len(np.unique(orca["neighbor_distance"][:, 1:])) == len(np.unique(force["wall_range"][:, 1:])) == 1
    assert now.rules.intentions == (Intention(0.15, 1.4, 2.7), Intention(0.15, 1.4, 2.7), Intention())
    together, alone = (
        drive("orca_margin", cases, "mixed", pedestrians__population=FITTED) for cases in ("val:3", "val:1:2")
    )
    assert np.array_equal(together.position[1:2, : alone.position.shape[1]], alone.position, equal_nan=True)


def test_draws_and_steps_do_not_depend_on_other_cases_or_threads(monkeypatch):
    together = drive("orca_margin", "val:3", fixture("populated"), pedestrians__arrival="leave")
    alone = drive("orca_margin", "val:2:3", fixture("populated"), pedestrians__arrival="leave")
    for field in ("position", "velocity", "radius"):
        one, other = getattr(together, field)[2], getattr(alone, field)[0]
        assert np.array_equal(one, other, equal_nan=True)
    monkeypatch.setattr("crowdbench.sim.intention.BLOCK_PEOPLE", 1)
    for number in (1, 3):
        monkeypatch.setattr(kernels, "number_of_threads", lambda number=number: number)
        assert same(drive("orca_margin", "val:3", fixture("populated"), pedestrians__arrival="leave"), together)


def test_a_new_person_draws_anew():
    changes = {"pedestrians.arrival": "respawn", "pedestrians.preferred_speed": 2.0, KEY: {**FITTED, **VARIED}}
    scenario = load_scenario("circle_crossing_5", changes)
    before = scenario.worlds(Cases.parse("val:10"))
    came = 0
    for _ in range(30):
        crowd, decided = crowd_decisions(before, scenario.policies)
        after = step_pedestrians(decided, crowd, scenario.post_step_rule)
        new = after.person != before.person
        if new.any():
            came += new.sum()
            _, then = crowd_decisions(after, scenario.policies)
            assert (after.radius[:, 1:][new] != before.radius[:, 1:][new]).all()
            assert (then.memory[INTENTION]["person"][new] == after.person[new]).all()
            ahead = toward_goal(after.position, after.goal, after.preferred_speed)[:, 1:][new]
            change = norm(intended(then)[new] - ahead)  # at rest before: it starts from the desired velocity
            assert (change < 0.1 * 5.0 * 0.15 * norm(ahead)).all()
        before = after
    assert came > 10


def test_members_of_a_group_have_one_speed_and_one_noise():
    changes = {"pedestrians.groups": {"2": 1.0}, "pedestrians.clear_space": None, KEY: {"noise": 0.2, **VARIED}}
    scenario = load_scenario(SCENARIO, changes)
    now = scenario.worlds(Cases.parse("val:2"))
    _, after = crowd_decisions(now, scenario.policies)
    noise = after.memory[INTENTION]["noise"]
    for row, number in np.ndindex(2, 10):
        members = now.group[row] == np.unique(now.group[row])[number]
        assert members.sum() == 2
        assert len(np.unique(noise[row, members], axis=0)) == 1
        assert len(np.unique(now.preferred_speed[row, 1:][members])) == 1
    assert len(np.unique(noise.reshape(-1, 2), axis=0)) == 20


def test_recorded_people_enter_with_their_velocity_and_vary_around_their_speed(shared):
    data = shared / "data" / "eth_ucy"
    changes = {"pedestrians.policy": {"recorded": 0.5, "orca": 0.5}}
    plain = load_scenario("eth_recorded", changes, data=data)
    varied = load_scenario("eth_recorded", changes | {KEY: {"inertia": 2.0, **VARIED}}, data=data)
    assert varied.rules.intentions == (Intention(0.0, 1.0, 2.0), Intention(), Intention())
    worlds = [scenario.worlds(Cases.parse("val:16")) for scenario in (plain, varied)]
    reacts = (worlds[0].policy == 0) & (worlds[0].person >= 0)
    assert np.array_equal(worlds[0].preferred_speed[:, 1:][~reacts], worlds[1].preferred_speed[:, 1:][~reacts])
    assert (worlds[0].preferred_speed[:, 1:][reacts] != worlds[1].preferred_speed[:, 1:][reacts]).all()
    now, entered = worlds[1], 0
    for _ in range(40):
        known = now.memory[INTENTION]["person"] >= 0
        crowd, after = crowd_decisions(now, varied.policies)
        before = now.velocity[:, 1:]
        desired = toward_goal(now.position, goals_on_way(now), now.preferred_speed)[:, 1:]
        far = norm(now.goal - now.position)[:, 1:] > 2.0 * now.preferred_speed[:, 1:]
        new = reacts & now.present[:, 1:] & ~known & far & (norm(before) > 0.0)
        expected = desired + math.exp(-DT / 2.0) * (before - desired)
        new &= norm(expected) < FASTEST * now.preferred_speed[:, 1:]
        assert intended(after)[new] == pytest.approx(expected[new], abs=1e-9)
        entered += new.sum()
        now = step_pedestrians(after, crowd, varied.post_step_rule)
    assert entered > 5


# Environments.


@pytest.mark.slow
def test_pedestrians_with_an_action_are_not_affected():
    env = parallel_env(load_scenario("circle_crossing_5", {KEY: FITTED}), action="velocity")
    env.reset(options={"case": "val/0"})
    assert env._compiled is None
    for _ in range(4):
        env.step({"vehicle": np.zeros(2), "pedestrian_2": np.array([0.0, 5.0])})
        assert env._world.velocity[0, 3] == pytest.approx([0.0, 1.0])
        assert norm(env._world.velocity[0, [1, 2, 4, 5]]).max() <= FASTEST


def test_environments_show_what_a_rollout_shows():
    name, changes = "circle_crossing_5", {KEY: {**FITTED, **VARIED}}
    trace = drive(Still(), "val:3", name, pedestrians__population={**FITTED, **VARIED})
    env = parallel_env(load_scenario(name, changes))
    vector = VehicleVectorEnv(3, load_scenario(name, changes))
    vector.reset(options={"case": ["val/0", "val/1", "val/2"]})
    env.reset(options={"case": "val/1"})
    for t in range(1, 6):
        env.step({"vehicle": np.zeros(2)})
        vector.step(np.zeros((3, 2), np.float32))
        assert np.array_equal(env._world.position[0, 1:], trace.position[1, t, 1:])
        assert np.array_equal(vector._worlds.position[:, 1:], trace.position[:, t, 1:])


def test_spaces_hold_what_people_can_do():
    changes = {
        "pedestrians.preferred_speed": 1.0,
        KEY: {"noise": 0.2, "shrinkage": 0.5, "spread": {"preferred_speed": 0.1}},
    }
    env = parallel_env(load_scenario("circle_crossing_5", changes), action="velocity")
    assert env.action_space("pedestrian_0").high == pytest.approx([1.1 * math.exp(0.2)] * 2)
    plain = parallel_env(load_scenario("circle_crossing_5"))
    assert (env.state_space.high >= plain.state_space.high).all()


# Scenarios.


def test_it_is_a_part_of_the_scenario_and_of_no_other():
    plain = load_scenario(SCENARIO)
    assert "population" not in plain.table["pedestrians"]
    assert plain.rules.intentions == ()
    varied = load_scenario(SCENARIO, {KEY: VARIED})
    fitted = load_scenario(SCENARIO, {KEY: {**FITTED, **VARIED}})
    assert varied.rules.intentions == ()  # nothing happens in a step
    assert fitted.rules.intentions == (Intention(0.15, 1.4, 2.7), Intention())
    assert len({plain.digest, varied.digest, fitted.digest}) == 3
    for rules in (plain.rules, fitted.rules):
        assert Rules.of_table(json.loads(json.dumps(rules.to_table()))) == rules
    state = fitted.worlds(Cases.parse("1")).memory[INTENTION]
    assert state.keys() == set(IntentionState._fields)


@pytest.mark.parametrize(
    ("population", "words"),
    [
        ({"noise": -0.1}, "pedestrians.population.noise is -0.1, but must be a number of at least 0 and below 10"),
        ({"noise_time": 0.0}, "pedestrians.population.noise_time is 0.0, but must be a number above 0"),
        ({"inertia": math.nan}, "pedestrians.population.inertia is nan, but must be a number of at least 0"),
        ({"shrinkage": 1.5}, "pedestrians.population.shrinkage is 1.5, but must be a share from 0 to 1"),
        ({"spread": 0.3}, "pedestrians.population.spread is 0.3, but must be a table such as { radius = 0.2"),
        ({"spread": {"radius": 2.0}}, "pedestrians.population.spread is {'radius': 2.0}, but must be a table such as"),
        (
            {"spread": {"horizon": 0.3}},
            "pedestrians.population.spread is a table with horizon, but must be of inertia, neighbor_distance, "
            "preferred_speed, radius, safety_space, time_horizon, time_horizon_obst",
        ),
        ({"spread": {"max_neighbors": 0.3}}, "spread is a table with max_neighbors, but must be of"),
        (
            {"noize": 0.1},
            "unknown key pedestrians.population.noize (did you mean noise?); the keys here are noise, noise_time",
        ),
        (0.3, "pedestrians.population is 0.3, but must be a table [pedestrians.population]"),
    ],
)
def test_a_bad_value_gets_one_sentence(population, words):
    with pytest.raises(InputError) as error:
        load_scenario(SCENARIO, {KEY: population})
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_cases_of_crowdnav_plus_have_none():
    with pytest.raises(InputError, match=r"pedestrians.population is given, but must be left out where crowdnav_cases"):
        load_scenario("crowdnav_plus_20", {KEY: FITTED})
    load_scenario("crowdnav_plus_20", {KEY: FITTED, "crowdnav_cases": 0})
