"""Policies, predictors, metrics and layouts: each point of a contract has a plug-in that breaks it and nothing else."""

import dataclasses
import functools
import random
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.check import check_layout, check_metric, check_policy, check_predictor
from crowdbench.check.examination import EXACT, NETWORKS
from crowdbench.check.kinds import limited_sight
from crowdbench.cli import app
from crowdbench.metrics import METRICS
from crowdbench.predict import ConstantVelocity, ConstantVelocitySampled, Oracle, Prediction, Predictor
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.floor_plan import floor_plan
from crowdbench.scenario.placement import Placement
from crowdbench.sim.pedestrians import PedestrianPolicy

# Crowds of several sizes, so that there is padding, in short episodes.
PLACE = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 3.5})
LIMITED = load_scenario("circle_crossing_mixed", {"time_limit": 3.5, **limited_sight(0.25)})
CASES = Cases.parse("val:5")
KEYS = PLACE.worlds(CASES).noise_key.tolist()
"""By these a plug-in here knows its cases."""

LIMITS = {"time": 0.05}
"""Seconds for those who break that point; all others may take as long as they like."""

STATELESS = {"deterministic", "batch", "padding"}


def verdicts(points):
    """The names of the points that are broken, and of those that could not be examined."""
    assert all(point.seen for point in points)
    return {point.name for point in points if point.kept is False}, {
        point.name for point in points if point.kept is None
    }


def seen(points, name):
    return next(point.seen for point in points if point.name == name)


class Walk(PedestrianPolicy):
    """Walks to the goal, unless `change` makes something else of the velocities in a step."""

    def __init__(self, change=lambda velocity, world: velocity):
        self.change = change

    def velocities(self, world, parameters):
        velocity = world.goal[:, 1:] - world.position[:, 1:]
        return self.change(velocity, world) if world.step[0] == 2 else velocity


def policy_points(make, tolerance=EXACT, limit=60.0):
    return check_policy(make, "orca", PLACE, CASES, limit, tolerance)


class Late:
    """Takes long, once."""

    seconds = 0.1

    def __call__(self, answer, *shown):
        time.sleep(self.seconds)
        self.seconds = 0.0
        return answer


def push(velocity, world):
    world.position[0, 1] += 1e-9
    return velocity


def fill_memory(velocity, world):
    world.memory["orca"]["heading"] = velocity
    return velocity


def with_nan(velocity, world):
    velocity[world.noise_key == KEYS[1], 0] = np.nan
    return velocity


def slower_alone(velocity, world):
    return velocity * (0.5 if len(world) == 1 else 1.0)


def slower_in_wide_arrays(velocity, world):
    return velocity * (0.5 if velocity.shape[1] > 10 else 1.0)


POLICIES = {
    "an exception": (lambda velocity, world: 1 / 0, "exceptions", "pedestrian policy orca raised ZeroDivisionError"),
    "late": (Late(), "time", "at most 0.1"),
    "a list": (lambda velocity, world: velocity.tolist(), "type and shape", "must return float64"),
    "one number": (lambda velocity, world: velocity[..., :1], "type and shape", "must return float64 of shape"),
    "single precision": (lambda velocity, world: velocity.astype(np.float32), "type and shape", "returned float32"),
    "not a number": (with_nan, "finite", "for pedestrian 0 of case 1, but a velocity must be finite"),
    "meddling": (push, "world", "changes world.position (case 0)"),
    "an array put into memory": (fill_memory, "world", "changes world.memory['orca']['heading'] (case 0)"),
    "herd": (slower_alone, "batch", "worlds' velocities differ when a case runs alone"),
    "padding": (slower_in_wide_arrays, "padding", "worlds' velocities differ with 3 more absent pedestrians"),
}


@pytest.mark.parametrize("name", POLICIES)
def test_an_offence_of_a_policy_breaks_its_point_alone(name):
    change, point, expected = POLICIES[name]
    points = policy_points(lambda: Walk(change), limit=LIMITS.get(point, 60.0))
    assert verdicts(points) == ({point}, set())
    assert expected in seen(points, point)


class Smooth(Walk):
    """Keeps the velocities of the call before: in whatever batch that was."""

    before = None

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        if self.before is not None and self.before.shape == velocity.shape:
            velocity = 0.5 * (velocity + self.before)
        self.before = velocity
        return velocity


class SmoothByCase(Walk):
    """Keeps the velocities of the call before by case, and forgets them when an episode starts."""

    def __init__(self):
        super().__init__()
        self.before = {}

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        for row, (case, step) in enumerate(zip(world.case.tolist(), world.step.tolist(), strict=True)):
            if step > 0 and case in self.before:
                velocity[row] = 0.5 * (velocity[row] + self.before[case])
            self.before[case] = velocity[row].copy()
        return velocity


class Dice(Walk):
    """Draws random numbers of its own."""

    def velocities(self, world, parameters):
        return super().velocities(world, parameters) * np.random.default_rng().uniform(0.9, 1.0)


def test_a_policy_with_a_state_or_dice_of_its_own_is_found():
    points = policy_points(Smooth)
    assert {"deterministic", "batch"} <= verdicts(points)[0] <= STATELESS
    assert "differ when it is shown the same again, from the last to the first" in seen(points, "deterministic")
    assert "deterministic" in verdicts(policy_points(SmoothByCase))[0] <= STATELESS
    assert verdicts(policy_points(Dice))[0] == STATELESS


def test_good_policies_keep_every_point():
    for make in (Walk, lambda: PEDESTRIANS.load("orca")[1]):
        assert verdicts(policy_points(make)) == (set(), set())


class Absent(Walk):
    """Returns what it likes for pedestrians that are not there."""

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        return np.where(world.present[:, 1:, None], velocity, len(world) * np.nan)


def test_what_a_policy_returns_for_the_absent_does_not_matter():
    assert verdicts(policy_points(Absent)) == (set(), set())


def test_only_networks_may_be_rounded_by_the_batch():
    def rounded(velocity, world):
        return velocity * (1.0 + 1e-9 * len(world))

    assert "batch" in verdicts(policy_points(lambda: Walk(rounded)))[0]
    assert verdicts(policy_points(lambda: Walk(rounded), NETWORKS)) == (set(), set())


def test_a_policy_that_never_answers_is_examined_where_it_can_be():
    class Never(PedestrianPolicy):
        def velocities(self, world, parameters):
            raise KeyError("goal")

    assert verdicts(policy_points(Never)) == (
        {"exceptions"},
        {"time", "type and shape", "finite", "deterministic", "batch", "padding"},
    )


class Guess(Predictor):
    """Constant velocity, and what `change` makes of it at step 3."""

    def __init__(self, change=lambda prediction, obs: prediction):
        self.change = change

    def predict(self, obs, steps):
        prediction = ConstantVelocity().predict(obs, steps)
        return self.change(prediction, obs) if obs.step[0] == 3 else prediction


def predictor_points(make, with_modes=None, limit=60.0, limited=None):
    return check_predictor(make, "mine", PLACE, CASES, limit, with_modes, limited=limited)


def changed_observation(prediction, obs):
    obs.pedestrians.history[:] += 1e-9
    return prediction


def infinite(prediction, obs):
    prediction.velocity[0, :, :, 0] = np.inf
    return prediction


def scaled(prediction, factor):
    return Prediction(prediction.position * factor, prediction.velocity * factor)


PREDICTORS = {
    "an exception": (lambda prediction, obs: [][1], "exceptions", "predictor mine raised IndexError"),
    "late": (Late(), "time", "at most 0.1"),
    "an array": (lambda prediction, obs: prediction.position, "type and shape", "a ndarray instead of a Prediction"),
    "infinite": (infinite, "finite", "returned velocities that are not finite"),
    "meddling": (changed_observation, "observation", "changes obs.pedestrians.history (step 3)"),
    "herd": (
        lambda prediction, obs: scaled(prediction, 0.5 if len(obs) == 1 else 1.0),
        "batch",
        "worlds' predictions differ when a case runs alone",
    ),
    "padding": (
        lambda prediction, obs: scaled(prediction, 1.0 + 0.1 * (obs.pedestrians.seen.shape[1] > 10)),
        "padding",
        "worlds' predictions differ with 3 more pedestrians who are not seen",
    ),
}


@pytest.mark.parametrize("name", PREDICTORS)
def test_an_offence_of_a_predictor_breaks_its_point_alone(name):
    change, point, expected = PREDICTORS[name]
    points = predictor_points(lambda: Guess(change), limit=LIMITS.get(point, 60.0))
    assert verdicts(points) == ({point}, set())
    assert expected in seen(points, point)


class Counts(Guess):
    """Predicts farther with every call."""

    calls = 0

    def predict(self, obs, steps):
        self.calls += 1
        return scaled(super().predict(obs, steps), 1.0 + 0.01 * self.calls)


def test_a_predictor_with_a_state_of_its_own_is_found():
    assert verdicts(predictor_points(Counts)) == ({"deterministic", "batch"}, set())


def test_good_predictors_keep_every_point():
    for make in (Oracle, ConstantVelocity):
        points = predictor_points(make, limited=LIMITED)
        assert verdicts(points) == (set(), set())
        assert "modes" not in [point.name for point in points]
    points = predictor_points(ConstantVelocitySampled, lambda modes: ConstantVelocitySampled(modes))
    assert verdicts(points) == (set(), set())
    assert seen(points, "modes").endswith("in the first 2 of 5 modes")


def velocities_of_the_hidden(crowd):
    return np.where(crowd.seen[:, :, None], 0.0, crowd.velocity)


# By what is added to all predictions: nothing with perfect sight, where the rows that are not seen are at rest.
PEEPS = {
    "hidden velocities": (
        lambda crowd: velocities_of_the_hidden(crowd).sum(axis=1),
        "with NaN in the rows of those who are not seen: predictor mine returned positions that are not finite",
    ),
    "a number where there is none": (
        lambda crowd: np.isnan(velocities_of_the_hidden(crowd)).any(axis=1).astype(float),
        "worlds' predictions differ with NaN in the rows of those who are not seen",
    ),
    "hidden velocities without NaN": (
        lambda crowd: np.nansum(velocities_of_the_hidden(crowd), axis=1),
        "worlds' predictions differ with other people in these rows",
    ),
    "an exception where nobody is seen": (
        lambda crowd: 0.0 * np.stack([row[mask][0] for row, mask in zip(crowd.position, crowd.seen, strict=True)]),
        "where the vehicle does not see everybody: predictor mine raised IndexError",
    ),
}


@pytest.mark.parametrize("name", PEEPS)
def test_a_predictor_that_depends_on_the_hidden_breaks_limited_sight_alone(name):
    peep, expected = PEEPS[name]

    class Peeps(Predictor):
        def predict(self, obs, steps):
            prediction = ConstantVelocity().predict(obs, steps)
            return Prediction(prediction.position + peep(obs.pedestrians)[:, None, None, None], prediction.velocity)

    points = predictor_points(Peeps, limited=LIMITED)
    assert verdicts(points) == ({"limited sight"}, set())
    assert expected in seen(points, "limited sight")


def test_limited_sight_is_not_examined_where_a_predictor_breaks_another_point():
    assert verdicts(predictor_points(Counts, limited=LIMITED)) == ({"deterministic", "batch"}, {"limited sight"})


class Fan(Guess):
    """Spreads its modes over the same width, however many there are."""

    def __init__(self, modes):
        super().__init__()
        self.modes = modes

    def predict(self, obs, steps):
        one = super().predict(obs, steps)
        factor = np.linspace(0.5, 1.5, self.modes)[:, None, None, None]
        return Prediction(one.position * factor, one.velocity * factor)


def test_modes_that_depend_on_their_number_break_that_point_alone():
    assert verdicts(predictor_points(lambda: Fan(4), Fan)) == ({"modes"}, set())


def metric_points(metric):
    return check_metric(lambda: metric, "mine", PLACE, CASES)


def speed(trace):
    """Mean speed of the vehicle [m/s]."""
    return np.nanmean(np.linalg.norm(trace.command, axis=2), axis=1)


def dirt(trace):
    trace.command[0, 0] = 9.0
    return np.zeros(len(trace))


def above_the_others(trace):
    return speed(trace) > speed(trace).mean()


CALLS = []


def counted(trace):
    CALLS.append(len(trace))
    return np.full(len(trace), float(CALLS.count(len(CASES)) if len(trace) == len(CASES) else 1.0))


METRICS_THAT_OFFEND = {
    "an exception": (lambda trace: trace.nothing, "exceptions", "metric mine raised AttributeError"),
    "needs what is not there": (lambda trace: trace.undisturbed[:, 0, 0, 0], "exceptions", "raised TypeError"),
    "a number": (lambda trace: 1.0, "one value", "returned float, but must return one number or boolean per episode"),
    "per step": (lambda trace: trace.gap, "one value", "but must return one number or boolean per episode"),
    "infinite": (lambda trace: speed(trace) / 0.0, "finite", "is inf in case 0"),
    "meddling": (dirt, "trace", "changes trace.command (case 0)"),
    "a rank": (above_the_others, "batch", "values differ when a case runs alone"),
}


@pytest.mark.parametrize("name", METRICS_THAT_OFFEND)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_an_offence_of_a_metric_breaks_its_point_alone(name):
    metric, point, expected = METRICS_THAT_OFFEND[name]
    points = metric_points(metric)
    assert verdicts(points)[0] == {point}
    assert expected in seen(points, point)


def test_a_metric_with_a_state_or_dice_of_its_own_is_found():
    assert "deterministic" in verdicts(metric_points(counted))[0]
    assert verdicts(metric_points(lambda trace: np.random.default_rng().random(len(trace))))[0] == {
        "deterministic",
        "batch",
    }


def test_all_metrics_of_crowdbench_keep_every_point():
    for metric in (speed, *METRICS.values()):
        assert verdicts(metric_points(metric)) == (set(), set())


def row_of_people(rng, radius, preferred_speed):
    """Everybody in a row, one metre apart, with a goal somewhere ahead."""
    start = np.stack([np.arange(len(radius)), np.zeros(len(radius))], axis=1).astype(float)
    return Placement(start, start + np.array([0.0, 5.0 + rng.random()]))


def changed_row(**changes):
    """A layout as `row_of_people`, with other parts: functions of the placement."""

    def layout(rng, radius, preferred_speed):
        placement = row_of_people(rng, radius, preferred_speed)
        return dataclasses.replace(placement, **{name: change(placement) for name, change in changes.items()})

    return layout


def box(middle, half):
    """Four walls around a point."""
    corners = middle + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


LATER = np.random.default_rng(0)

LAYOUTS_THAT_OFFEND = {
    "an exception": (lambda rng, radius, speed: radius[99], "exceptions", "layout mine in case 0 raised IndexError"),
    "a pair": (lambda rng, radius, speed: (radius, radius), "shape", "a tuple instead of a Placement"),
    "too few": (changed_row(goal=lambda one: one.goal[1:]), "shape", "with goal of shape"),
    "a flat wall": (
        changed_row(obstacles=lambda one: np.zeros((2, 2))),
        "shape",
        "obstacles of shape [2, 2] instead of [any number, any number, 2]",
    ),
    "nowhere": (changed_row(goal=lambda one: one.goal * np.nan), "finite", "the vehicle the goal [nan, nan]"),
    "a heap": (changed_row(start=lambda one: one.start * 0.5), "overlap", "agents 0 and 1 overlap by 0.1 m"),
    "nothing to do": (changed_row(goal=lambda one: one.start + 0.1), "goal", "the vehicle start 0.141 m from its goal"),
    "a pedestrian with nothing to do": (
        changed_row(goal=lambda one: np.vstack([one.goal[:1], one.start[1:]])),
        "goal",
        "agent 1 start at its goal",
    ),
    "a wall through people": (
        changed_row(obstacles=lambda one: np.array([[[-1.0, 0.2], [9.0, 0.2]]])),
        "obstacles",
        "the start of the vehicle, [0.0, 0.0], is 0.2 m from obstacles[0]",
    ),
    "a box around a goal": (
        changed_row(obstacles=lambda one: box(one.goal[0], 0.5)),
        "ways",
        "no way leads the vehicle from (0, 0) to its goal",
    ),
    "a route through a wall": (
        changed_row(
            obstacles=lambda one: np.array([[[-3.0, 3.0], [0.5, 3.0]]]),
            route=lambda one: np.full((len(one.start), 1, 2), np.nan),
        ),
        "ways",
        "the route of the vehicle leads 0 m past an obstacle",
    ),
    "NumPy's dice": (
        changed_row(goal=lambda one: one.goal + np.random.rand()),  # noqa: NPY002 (the offence)
        "random numbers",
        "draws from NumPy's shared generator instead of its stream",
    ),
    "Python's dice": (changed_row(goal=lambda one: one.goal + random.random()), "random numbers", "Python's shared"),
    "dice of its own": (
        changed_row(goal=lambda one: one.goal + LATER.random()),
        "deterministic",
        "placements differ when it is given the same again",
    ),
}


def plain(self, start, goal, route=None, obstacles=None):
    for name, value in (("start", start), ("goal", goal), ("route", route), ("obstacles", obstacles)):
        object.__setattr__(self, name, value)


def layout_points(layout):
    return check_layout(layout, "mine", PLACE, CASES)


def test_what_groups_make_of_a_layout_is_examined_by_what_a_run_does():
    def alley(rng, radius, preferred_speed):
        """A lane of 1.2 m, in which there is no room for two abreast."""
        place = np.arange(len(radius)) * 2.0
        start, goal = np.stack([place, 0.0 * place], axis=1), np.stack([place + 60.0, 0.0 * place], axis=1)
        walls = np.array([[[-5.0, side], [80.0, side]] for side in (-0.6, 0.6)])
        return Placement(start, goal, obstacles=walls)

    def points(groups):
        place = load_scenario("circle_crossing_5", {"time_limit": 3.5, **groups})
        return check_layout(alley, "alley", place, Cases.parse("val:2"))

    alone, together = points({}), points({"pedestrians.groups": {"2": 1.0}})
    assert "whole cases" not in verdicts(alone)[0]
    assert "whole cases" in verdicts(together)[0]
    said = seen(together, "whole cases")
    assert "the start of pedestrian" in said
    assert "the layout placed its group; members stand side by side around that place" in said
    assert seen(alone, "again").startswith("room for")


@pytest.mark.parametrize("name", LAYOUTS_THAT_OFFEND)
def test_an_offence_of_a_layout_breaks_its_point_alone(name, monkeypatch):
    # Without the checks of the tests, which would be an exception in the layout.
    monkeypatch.setattr(Placement, "__init__", plain)
    layout, point, expected = LAYOUTS_THAT_OFFEND[name]
    points = layout_points(layout)
    assert verdicts(points)[0] == {point}
    assert expected in seen(points, point)


def test_good_layouts_keep_every_point():
    assert verdicts(layout_points(row_of_people)) == (set(), set())
    regions = {"left": [[-9.0, -6.0], [-3.0, 6.0]], "right": [[3.0, -6.0], [9.0, 6.0]]}
    plan = functools.partial(floor_plan, regions=regions, vehicle=["left", "right"], ways=[["left", "right"]])
    for layout in [plan, *(layout for layout in LAYOUTS.values() if layout is not floor_plan)]:
        # The type checker of the tests draws from Python's shared generator.
        assert verdicts(layout_points(layout))[0] <= {"random numbers"}


FILES = {
    "policy": "from crowdbench.sim.pedestrians import ORCA\ndef policy(): return ORCA()\n",
    "predictor": "from crowdbench.predict import Linear\ndef predictor(): return Linear()\n",
    "metric": "def metric(trace): return trace.steps / 2\n",
    "planner": "from crowdbench.planners.reactive import ORCAPlanner\ndef planner(): return ORCAPlanner()\n",
}


def command(*arguments):
    return CliRunner().invoke(app, ["check", *arguments, "--cases", "val:1"])


@pytest.mark.parametrize("function", FILES)
def test_the_kind_is_found_by_the_function_of_the_file(function, tmp_path):
    points = {"policy": "padding", "predictor": "observation", "metric": "one value", "planner": "decision time"}
    (tmp_path / "mine.py").write_text(FILES[function])
    done = command(str(tmp_path / "mine.py"))
    assert done.exit_code == 0, done.output
    assert points[function] in done.output


def test_a_file_of_two_kinds_or_of_none_is_told(tmp_path):
    both = tmp_path / "both.py"
    both.write_text(FILES["planner"] + FILES["policy"])
    message = str(command(str(both)).exception)
    assert "defines planner() and policy(): say which is meant, with --kind planners or --kind pedestrians" in message
    assert "padding" in command(str(both), "--kind", "pedestrians").output
    both.write_text("")
    message = str(command(str(both)).exception)
    assert "defines no function planner(), policy(), predictor(), metric(), layout() or reward()" in message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("orca", "--kind", "policies"),
            "--kind is planners, pedestrians, predictors, metrics, layouts, rewards or scenarios",
        ),
        (("star", "--kind", "layouts"), "no layout is called 'star'; there are circle_crossing, square_crossing"),
        (("circle_crossing", "--kind", "layouts", "--option", "radius=2"), "unknown key layout.radius"),
        (("length", "--kind", "metrics"), "no metric is called 'length'; there are success_rate, "),
        (("orca", "--kind", "pedestrians", "--option", "a=1"), "a pedestrian policy, which has no options"),
    ],
)
def test_what_cannot_be_checked_is_told(arguments, message):
    assert message in str(command(*arguments).exception)
