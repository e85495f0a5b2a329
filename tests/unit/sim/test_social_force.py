import dataclasses

import numpy as np
import pytest
from helpers import advance, drive, same, with_walkers

from agents.planners.social_force import SocialForcePlanner
from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.core import rng
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import forces, social_force
from crowdbench.sim.pedestrians.social_force import SOFTNESS
from crowdbench.sim.simulator import crowd_velocities


def social_force_velocities(*inputs, **options):
    """The function of that name, with agents and parameters as arguments."""
    return with_walkers(social_force.social_force_velocities, social_force.PARAMETERS, *inputs, **options)


STEADY = {"fluctuation": 0.0}
CROWD = "circle_crossing_5_social_force"


def scenes(worlds, agents, seed=0, size=3.0):
    rng = np.random.default_rng(seed)
    position, goal = rng.uniform(-size, size, (2, worlds, agents, 2))
    velocity, noise = rng.uniform(-0.6, 0.6, (worlds, agents, 2)), rng.normal(size=(worlds, agents, 2))
    return (
        position,
        velocity,
        goal,
        rng.uniform(0.2, 0.4, (worlds, agents)),
        rng.uniform(0.7, 1.4, (worlds, agents)),
        noise,
    )


def scene(position, velocity, goal, speed=1.0):
    """One world of discs with radius 0.3 and no noise."""
    position, velocity, goal = (np.array([values], float) for values in (position, velocity, goal))
    shape = position.shape[:2]
    return position, velocity, goal, np.full(shape, 0.3), np.full(shape, speed), np.zeros((*shape, 2))


def walk(inputs, steps, time_step=0.25, **options):
    """Positions `[time, world, agent, 2]` and velocities of agents that the simulator would move so."""
    position, velocity, *others = inputs
    states = [(position, velocity)]
    for _ in range(steps):
        velocity = social_force_velocities(position, velocity, *others, time_step=time_step, **(STEADY | options))
        position = position + time_step * velocity
        states.append((position, velocity))
    return np.stack([state[0] for state in states]), np.stack([state[1] for state in states])


def step_of(world, scenario):
    """The world one step later, the vehicle standing."""
    return advance(world, np.pad(crowd_velocities(world, scenario.policies), ((0, 0), (1, 0), (0, 0))))


def acceleration(inputs, **options):
    """What each agent of the only world feels at this moment, in m/s^2."""
    moment = 1e-6
    velocity = social_force_velocities(*inputs, time_step=moment, **(STEADY | options))
    return ((velocity - inputs[1]) / moment)[0]


def potential(r, step, traits):
    """Equation 3, with equation 4's semi-minor axis b."""
    b = 0.5 * np.sqrt((np.linalg.norm(r) + np.linalg.norm(r - step)) ** 2 - step @ step)
    return traits["repulsion_strength"] * np.exp(-b / traits["repulsion_range"])


def slow_force(i, position, velocity, goal, radius, speed, seen, traits):
    """Equations 2, 3, 4, 7 and 8, the gradient by differences; the desired velocity and the force without driving."""
    offset = goal[i] - position[i]
    direction = offset / np.linalg.norm(offset)
    desired = direction * min(speed[i], np.linalg.norm(offset))
    force = np.zeros(2)
    for j in range(len(position)):
        if j == i or not seen[j]:
            continue
        between = position[i] - position[j]
        gap = np.linalg.norm(between) - radius[i] - radius[j]
        r = between / np.linalg.norm(between) * (gap + np.hypot(gap, 2 * SOFTNESS)) / 2
        step = traits["look_ahead"] * velocity[j]
        f = np.array([potential(r - h, step, traits) - potential(r + h, step, traits) for h in 1e-6 * np.eye(2)]) / 2e-6
        ahead = direction @ -f >= np.linalg.norm(f) * np.cos(traits["sight_angle"] / 2)
        force += f if ahead else traits["behind_weight"] * f
    return desired, force


def slow_step(position, velocity, goal, radius, speed, noise, seen, moves, traits):
    """One world's step of 0.25 s in five sub-steps."""
    x, v, tau = position.copy(), velocity.copy(), traits["relaxation_time"]
    decay = np.exp(-0.25 / tau)
    size = traits["fluctuation"] * np.sqrt(1 - decay**2) / (tau * (1 - decay))
    for _ in range(5):
        new = v.copy()
        for i in np.flatnonzero(moves):
            desired, force = slow_force(i, x, v, goal, radius, speed, seen, traits)
            target = desired + tau * (force + noise[i] * size * np.linalg.norm(desired) / speed[i])
            new[i] = target + (v[i] - target) * np.exp(-0.05 / tau)
            new[i] *= min(1.0, speed[i] / np.linalg.norm(new[i]))
        v, x = new, x + 0.05 * new
    return np.where(moves[:, None], v, 0.0)


@pytest.mark.parametrize(
    "traits",
    [
        {},
        {"relaxation_time": 0.3, "repulsion_strength": 1.1, "repulsion_range": 0.5, "look_ahead": 1.0}
        | {"sight_angle": 2.0, "behind_weight": 0.2, "fluctuation": 0.2},
    ],
)
def test_a_step_agrees_with_the_equations(traits):
    inputs = scenes(15, 5)
    seen, moves = np.random.default_rng(3).random((2, 15, 5)) < 0.8
    complete = dict(PEDESTRIANS.load("social_force")[1].parameters) | traits
    slow = [slow_step(*(array[w] for array in inputs), seen[w], moves[w], complete) for w in range(15)]
    fast = social_force_velocities(*inputs, seen=seen, moves=moves, **traits)
    assert np.abs(fast - slow).max() < 1e-6


def test_parameters_may_differ_between_agents():
    inputs = scenes(10, 4)
    tau = np.random.default_rng(1).choice([0.3, 0.8], (10, 4))
    # One sub-step: in the next, everybody meets others who have moved otherwise.
    mixed, quick, slow = (
        social_force_velocities(*inputs, relaxation_time=value, time_step=0.05) for value in (tau, 0.3, 0.8)
    )
    assert np.array_equal(mixed, np.where(tau[..., None] == 0.3, quick, slow))
    assert not np.array_equal(quick, slow)


@pytest.mark.parametrize("tau", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("time_step", [0.1, 0.25])
def test_speed_relaxes_to_the_preferred_speed_with_the_relaxation_time(tau, time_step):
    _, velocity = walk(scene([[0, 0]], [[0, 0]], [[99, 0]], speed=1.3), 100, time_step, relaxation_time=tau)
    speed = velocity[:, 0, 0, 0]
    found = -time_step * np.arange(1, 6) / np.log(1 - speed[1:6] / 1.3)
    assert found == pytest.approx(np.full(5, tau), rel=0.05)
    assert speed[-1] == pytest.approx(1.3, rel=1e-4)


def test_halving_the_sub_step_changes_little(monkeypatch):
    scenario = load_scenario(CROWD)
    world = scenario.worlds(Cases.parse("50"))
    change = {0.25: [], 0.05: []}
    for _ in range(40):
        fields = (world.position, world.velocity, world.goal, world.radius, world.preferred_speed)
        inputs = (*(field[:, 1:] for field in fields), np.zeros_like(world.position[:, 1:]))
        for sub_step, changes in change.items():
            found = []
            for longest in (sub_step, sub_step / 2):
                monkeypatch.setattr(forces, "SUB_STEP", longest)
                found.append(social_force_velocities(*inputs))
            changes.append(np.linalg.norm(found[0] - found[1], axis=-1))
        monkeypatch.undo()
        world = step_of(world, scenario)
    assert np.median(change[0.05]) < 0.005
    assert np.quantile(change[0.05], 0.95) < 0.04
    assert np.quantile(change[0.25], 0.95) > 0.08


def test_a_lone_pair_meets_as_in_a_mirror():
    meeting = scene([[-4, 0.1], [4, -0.1]], [[1, 0], [-1, 0]], [[4, 0.1], [-4, -0.1]])
    position, _ = walk(meeting, 60)
    assert np.abs(position[:, 0, 0] + position[:, 0, 1]).max() < 1e-9
    flip = np.array([1.0, -1.0])
    reflected, _ = walk((*(array * flip for array in meeting[:3]), *meeting[3:]), 60)
    assert np.abs(reflected - position * flip).max() < 1e-9
    assert np.linalg.norm(position[:, 0, 0] - position[:, 0, 1], axis=-1).min() > 0.6
    assert np.linalg.norm(position[-1] - meeting[2], axis=-1).max() < 0.1


def test_who_stands_behind_counts_half():
    def felt(angle):
        other = np.array([np.cos(angle), np.sin(angle)])
        alone = acceleration(scene([[0, 0]], [[0.5, 0]], [[9, 0]]))[0]
        return np.linalg.norm(acceleration(scene([[0, 0], other], [[0.5, 0], [0, 0]], [[9, 0], other]))[0] - alone)

    ahead = felt(0.0)
    assert ahead > 1.0
    assert felt(np.radians(99.0)) == pytest.approx(ahead, rel=1e-4)
    assert felt(np.radians(101.0)) == pytest.approx(0.5 * ahead, rel=1e-4)
    assert felt(np.pi) == pytest.approx(0.5 * ahead, rel=1e-4)


def test_who_comes_nearer_repels_more_than_who_goes_away():
    def felt(velocity):
        inputs = scene([[0, 0], [1.2, 0.3]], [[0, 0], velocity], [[0, 0], [9, 9]])
        return np.linalg.norm(acceleration(inputs)[0])

    assert felt([-1, 0]) > 1.5 * felt([0, 0]) > 1.5 * felt([1, 0])


def test_two_lanes_of_opposed_walkers_pass_mostly_without_overlap():
    rng = np.random.default_rng(0)
    row = np.stack([np.arange(8) * 1.5, np.zeros(8)], axis=-1)
    start = np.concatenate([row - [14, 0], [14, 0] - row])[None] + rng.uniform(-0.3, 0.3, (20, 16, 2))
    goal = start + np.repeat([[28.0, 0.0], [-28.0, 0.0]], 8, axis=0)
    shape = start.shape[:2]
    position, _ = walk(
        (start, np.zeros_like(start), goal, np.full(shape, 0.3), np.ones(shape), np.zeros_like(start)), 180
    )
    one, two = np.triu_indices(16, 1)
    distance = np.linalg.norm(position[:, :, one] - position[:, :, two], axis=-1)
    assert (distance < 0.6).mean() < 1e-3
    assert (np.abs(position[-1] - goal)[..., 0] < 2.0).mean() > 0.95


def test_overlapping_pedestrians_part():
    position, _ = walk(scene([[0, 0], [0.3, 0]], [[0, 0], [0, 0]], [[0, 0], [0.3, 0]]), 8)
    distance = np.linalg.norm(position[:, 0, 0] - position[:, 0, 1], axis=-1)
    assert distance[-1] > 0.6
    assert (np.diff(distance[:4]) > 0).all()


@pytest.mark.parametrize("offset", [0.0, 1e-12])
def test_who_stands_in_the_very_same_place_or_exactly_in_the_way_gives_no_nonsense(offset):
    for gap in (0.0, 1.5, 5.0):
        inputs = scene([[0, 0], [gap, offset]], [[1, 0], [-1, 0]], [[9, 0], [-9, offset]])
        assert np.isfinite(social_force_velocities(*inputs)).all()


def test_an_arrived_pedestrian_comes_to_rest_in_spite_of_the_noise():
    inputs = scene([[0, 0]], [[1, 0]], [[3, 0]])
    inputs[-1][:] = 1.0
    position, velocity = walk(inputs, 80, fluctuation=0.05)
    assert np.linalg.norm(position[-1, 0, 0] - [3, 0]) < 1e-6
    assert np.linalg.norm(velocity[-1]) < 1e-6
    assert position[:, 0, 0, 0].max() < 3.1


@pytest.mark.parametrize("time_step", [0.1, 0.25])
def test_the_fluctuation_has_its_size_at_any_time_step(time_step):
    worlds = 3000
    position, velocity, goal = np.zeros((3, worlds, 1, 2))
    goal[..., 0] = 1e6
    keys = rng.case_keys(0, "train", np.arange(worlds))
    for step in range(30):
        noise = rng.normal(keys, "test", np.full(worlds, step), (1, 2))
        velocity = social_force_velocities(
            position, velocity, goal, np.full((worlds, 1), 0.3), np.ones((worlds, 1)), noise,
            time_step=time_step, fluctuation=0.1,
        )  # fmt: skip
    assert velocity[..., 1].std() == pytest.approx(0.1, rel=0.05)


def test_one_thread_and_many_give_the_same_bits(monkeypatch):
    inputs = scenes(200, 6)
    monkeypatch.setattr(forces, "BLOCK_PAIRS", 10**9)
    serial = social_force_velocities(*inputs)
    monkeypatch.setattr(forces, "BLOCK_PAIRS", 1)
    assert np.array_equal(serial, social_force_velocities(*inputs))


def test_a_world_does_not_depend_on_its_batch():
    inputs = scenes(20, 6)
    together = social_force_velocities(*inputs)
    alone = [social_force_velocities(*(array[w : w + 1] for array in inputs))[0] for w in range(20)]
    assert np.array_equal(together, np.stack(alone))


def test_nobody_avoids_an_agent_that_is_not_seen():
    inputs = scenes(50, 6)
    seen = np.ones((50, 6), bool)
    seen[:, 0] = False
    with_ghost = social_force_velocities(*inputs, seen=seen)
    assert np.array_equal(with_ghost[:, 1:], social_force_velocities(*(array[:, 1:] for array in inputs)))
    assert not np.array_equal(with_ghost, social_force_velocities(*inputs))


def test_nobody_is_faster_than_its_preferred_speed():
    inputs = scenes(100, 12)
    taken = np.linalg.norm(social_force_velocities(*inputs), axis=-1)
    assert (taken <= inputs[4] * (1 + 1e-9)).all()


def test_the_vehicle_is_avoided_where_it_is_visible_alone():
    def crowd(visible, place):
        scenario = load_scenario(CROWD, {"vehicle.visible": visible})
        world = scenario.worlds(Cases.parse("20"))
        position = world.position.copy()
        position[:, 0] = position[:, 1] + place
        return crowd_velocities(world.replace(position=position), scenario.policies)

    assert np.array_equal(crowd(False, 1.0), crowd(False, 50.0))
    assert not np.allclose(crowd(True, 1.0), crowd(True, 50.0))


def test_the_crowd_fluctuates_the_same_in_any_batch_and_at_any_padding():
    scenario = load_scenario(CROWD, {"pedestrians.number": [3, 5]})
    world = scenario.worlds(Cases.parse("30"))
    for _ in range(8):
        crowd = crowd_velocities(world, scenario.policies)
        for w in range(0, 30, 5):
            agents = world.present[w].sum()
            row = world.take(np.array([w]))
            narrow = {
                name: getattr(row, name)[:, :agents]
                for name in (
                    "position",
                    "velocity",
                    "goal",
                    "route",
                    "waypoint",
                    "radius",
                    "preferred_speed",
                    "present",
                )
            }
            table = {name: values[:, :agents] for name, values in row.parameters["social_force"].items()}
            alone = crowd_velocities(row.replace(**narrow, parameters={"social_force": table}), scenario.policies)
            assert np.array_equal(alone[0], crowd[w, : agents - 1])
        world = step_of(world, scenario)
    steady = world.parameters["social_force"] | {"fluctuation": np.zeros_like(world.radius)}
    calm = crowd_velocities(world.replace(parameters={"social_force": steady}), scenario.policies)
    moving = world.present[:, 1:]
    assert not np.isclose(calm, crowd_velocities(world, scenario.policies))[moving].any(axis=-1).all()


def test_a_social_force_crowd_reaches_its_goals_and_hardly_overlaps():
    scenario = load_scenario(CROWD)
    world = scenario.worlds(Cases.parse("100"))
    one, two = np.triu_indices(5, 1)
    closest = np.full(100, np.inf)
    for _ in range(120):
        world = step_of(world, scenario)
        place = world.position[:, 1:]
        closest = np.minimum(closest, np.linalg.norm(place[:, one] - place[:, two], axis=-1).min(axis=1))
    left = np.linalg.norm(world.position - world.goal, axis=-1)[:, 1:]
    assert (left < 1.0).mean() > 0.98
    assert (closest < 0.6).mean() < 0.02


@pytest.mark.slow
def test_the_planner_goes_round_pedestrians_and_keeps_the_space_it_is_told():
    alone = drive("social_force", pedestrians__number=0)
    assert (alone.outcome == 1).all()
    among, shy = (drive(SocialForcePlanner(space), cases="30") for space in (0.0, 0.3))
    assert (among.outcome == 1).mean() > 0.7
    assert np.nanmin(shy.gap, axis=1).mean() > np.nanmin(among.gap, axis=1).mean() + 0.1


@pytest.mark.slow
def test_the_planner_gives_the_same_episode_in_any_batch():
    together = drive("social_force", scenario=CROWD, cases="6")
    alone = [drive("social_force", scenario=CROWD, cases=f"{case}:{case + 1}") for case in range(6)]
    for field in dataclasses.fields(together):
        if field.name in ("outcome", "position", "gap"):
            values = np.concatenate([getattr(trace, field.name) for trace in alone])
            assert np.array_equal(values, getattr(together, field.name), equal_nan=True)
    assert same(together, drive("social_force", scenario=CROWD, cases="6"))
