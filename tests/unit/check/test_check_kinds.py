"""`crowdbench check` on policies, predictors, metrics, layouts, rewards and scenarios: each fault is found."""

import dataclasses
import functools
import random
import time
from pathlib import Path

import numpy as np
import pytest
from checks import CASES, PLACE, broken, policy_faults, results_of
from typer.testing import CliRunner

from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.check.contract import Subject
from crowdbench.check.kinds import limited_sight
from crowdbench.check.subjects import METRIC, PREDICTOR, REWARD, SCENARIO
from crowdbench.cli import app
from crowdbench.envs.rewards import REWARDS
from crowdbench.metrics import METRICS
from crowdbench.predict import ConstantVelocity, ConstantVelocitySampled, Oracle, Prediction, Predictor
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.floor_plan import floor_plan
from crowdbench.scenario.placement import LayoutCall, Placement
from crowdbench.sim.pedestrians import PedestrianPolicy

LIMITED = load_scenario("circle_crossing_mixed", {"time_limit": 3.5, **limited_sight(0.25)})
KEYS = PLACE.worlds(CASES).noise_key.tolist()
"""By these a plug-in here knows its cases."""


class Walk(PedestrianPolicy):
    """Walks to the goal, unless `change` makes something else of the velocities in a step."""

    def __init__(self, change=lambda velocity, world: velocity):
        self.change = change

    def velocities(self, world, parameters):
        velocity = world.goal[:, 1:] - world.position[:, 1:]
        return self.change(velocity, world) if world.step[0] == 2 else velocity


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
    "an exception": (lambda velocity, world: 1 / 0, "answers", "pedestrian policy orca raised ZeroDivisionError"),
    "late": (Late(), "answers", "took longer than the limit of 0.05 s (case 0, step 2"),
    "a list": (lambda velocity, world: velocity.tolist(), "answers", "must return float64"),
    "one number": (lambda velocity, world: velocity[..., :1], "answers", "must return float64 of shape"),
    "single precision": (lambda velocity, world: velocity.astype(np.float32), "answers", "returned float32"),
    "not a number": (with_nan, "answers", "for pedestrian 0 of case 1, but a velocity must be finite"),
    "meddling": (push, "answers", "changes world.position (case 0, step 2"),
    "an array put into memory": (fill_memory, "answers", "changes world.memory['orca']['heading'] (case 0, step 2"),
    "herd": (slower_alone, "independent", "worlds' velocities differ when a case is driven alone"),
    "padding": (slower_in_wide_arrays, "independent", "worlds' velocities differ with 3 more absent pedestrians"),
}


@pytest.mark.parametrize("name", POLICIES)
def test_a_fault_of_a_policy_is_found(name):
    change, check, expected = POLICIES[name]
    faults = policy_faults(lambda: Walk(change), limit=0.05 if name == "late" else 60.0)
    assert set(faults) == {check}
    assert expected in faults[check]


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
    assert "differ when it is asked again, first in case" in policy_faults(Smooth)["repeatable"]
    assert "repeatable" in policy_faults(SmoothByCase)
    assert set(policy_faults(Dice)) == {"repeatable", "independent"}


def test_good_policies_pass():
    for make in (Walk, lambda: PEDESTRIANS.load("orca")[1]):
        assert not policy_faults(make)


class Absent(Walk):
    """Returns what it likes for pedestrians that are not there."""

    def velocities(self, world, parameters):
        velocity = super().velocities(world, parameters)
        return np.where(world.present[:, 1:, None], velocity, len(world) * np.nan)


def test_what_a_policy_returns_for_the_absent_does_not_matter():
    assert not policy_faults(Absent)


def test_only_networks_may_be_rounded_by_the_batch():
    def rounded(velocity, world):
        return velocity * (1.0 + 1e-9 * len(world))

    assert set(policy_faults(lambda: Walk(rounded))) == {"independent"}
    assert not policy_faults(lambda: Walk(rounded), neural=True)


class Guess(Predictor):
    """Constant velocity, and what `change` makes of it at step 3."""

    def __init__(self, change=lambda prediction, obs: prediction):
        self.change = change

    def predict(self, obs, steps):
        prediction = ConstantVelocity().predict(obs, steps)
        return self.change(prediction, obs) if obs.step[0] == 3 else prediction


def predictor_faults(make, limit=60.0, limited=False):
    scenarios = {"": PLACE} | ({"with limited sight: ": LIMITED} if limited else {})
    return broken(results_of(Subject(PREDICTOR, make, "mine", scenarios, limit, neural=False)))


def changed_observation(prediction, obs):
    obs.pedestrians.history[:] += 1e-9
    return prediction


def infinite(prediction, obs):
    prediction.velocity[0, :, :, 0] = np.inf
    return prediction


def scaled(prediction, factor):
    return Prediction(prediction.position * factor, prediction.velocity * factor)


PREDICTORS = {
    "an exception": (lambda prediction, obs: [][1], "answers", "predictor mine raised IndexError"),
    "late": (Late(), "answers", "took longer than the limit of 0.05 s (case 0, step 3)"),
    "an array": (lambda prediction, obs: prediction.position, "answers", "a ndarray instead of a Prediction"),
    "infinite": (infinite, "answers", "returned velocities that are not finite"),
    "meddling": (changed_observation, "answers", "changes obs.pedestrians.history (case 0, step 3)"),
    "herd": (
        lambda prediction, obs: scaled(prediction, 0.5 if len(obs) == 1 else 1.0),
        "independent",
        "worlds' predictions differ when a case is driven alone",
    ),
    "padding": (
        lambda prediction, obs: scaled(prediction, 1.0 + 0.1 * (obs.pedestrians.seen.shape[1] > 10)),
        "independent",
        "worlds' predictions differ with 3 more absent pedestrians",
    ),
}


@pytest.mark.parametrize("name", PREDICTORS)
def test_a_fault_of_a_predictor_is_found(name):
    change, check, expected = PREDICTORS[name]
    faults = predictor_faults(lambda: Guess(change), limit=0.05 if name == "late" else 60.0)
    assert set(faults) == {check}
    assert expected in faults[check]


class Counts(Guess):
    """Predicts farther with every call."""

    calls = 0

    def predict(self, obs, steps):
        self.calls += 1
        return scaled(super().predict(obs, steps), 1.0 + 0.01 * self.calls)


def test_a_predictor_with_a_state_of_its_own_is_found():
    assert "when it is asked again" in predictor_faults(Counts)["repeatable"]


def test_good_predictors_pass():
    for make in (Oracle, ConstantVelocity, ConstantVelocitySampled):
        assert not predictor_faults(make, limited=True)


def velocities_of_the_hidden(crowd):
    return np.where(crowd.seen[:, :, None], 0.0, crowd.velocity)


# By what is added to all predictions: nothing with perfect sight, where the rows that are not seen are at rest.
PEEPS = {
    "hidden velocities": (
        lambda crowd: velocities_of_the_hidden(crowd).sum(axis=1),
        "and NaN in the rows of unseen pedestrians: predictor mine returned positions that are not finite",
    ),
    "a number where there is none": (
        lambda crowd: np.isnan(velocities_of_the_hidden(crowd)).any(axis=1).astype(float),
        "worlds' predictions differ with 3 more absent pedestrians, and NaN in the rows of unseen pedestrians",
    ),
    "an exception where nobody is seen": (
        lambda crowd: 0.0 * np.stack([row[mask][0] for row, mask in zip(crowd.position, crowd.seen, strict=True)]),
        "with limited sight: predictor mine raised IndexError",
    ),
}


@pytest.mark.parametrize("name", PEEPS)
def test_a_predictor_that_depends_on_the_hidden_is_found(name):
    peep, expected = PEEPS[name]

    class Peeps(Predictor):
        def predict(self, obs, steps):
            prediction = ConstantVelocity().predict(obs, steps)
            return Prediction(prediction.position + peep(obs.pedestrians)[:, None, None, None], prediction.velocity)

    faults = predictor_faults(Peeps, limited=True)
    assert set(faults) == {"answers" if "exception" in name else "independent"}
    assert expected in "".join(faults.values())


def metric_faults(metric, cases=CASES):
    return broken(results_of(Subject(METRIC, lambda: metric, "mine", {"": PLACE}, neural=False), cases))


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
    "an exception": (lambda trace: trace.nothing, "answers", "metric mine raised AttributeError"),
    "needs what is not there": (lambda trace: trace.undisturbed[:, 0, 0, 0], "answers", "raised TypeError"),
    "a number": (lambda trace: 1.0, "answers", "returned float, but must return one number or boolean per episode"),
    "per step": (lambda trace: trace.gap, "answers", "but must return one number or boolean per episode"),
    "infinite": (lambda trace: speed(trace) / 0.0, "answers", "is inf in case 0"),
    "meddling": (dirt, "answers", "changes trace.command (case 0)"),
    "a rank": (above_the_others, "independent", "values differ when a case is driven alone"),
}


@pytest.mark.parametrize("name", METRICS_THAT_OFFEND)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_a_fault_of_a_metric_is_found(name):
    metric, check, expected = METRICS_THAT_OFFEND[name]
    faults = metric_faults(metric)
    assert set(faults) == {check}
    assert expected in faults[check]


def test_a_metric_with_a_state_or_dice_of_its_own_is_found():
    assert "repeatable" in metric_faults(counted)
    assert set(metric_faults(lambda trace: np.random.default_rng().random(len(trace)))) == {"repeatable", "independent"}


def test_all_metrics_of_crowdbench_pass():
    for metric in (speed, *METRICS.values()):
        assert not metric_faults(metric, Cases.parse("val:2"))


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
    "an exception": (lambda rng, radius, speed: radius[99], "answers", "in case val/0, the layout raised IndexError"),
    "a pair": (lambda rng, radius, speed: (radius, radius), "answers", "a tuple instead of a Placement"),
    "too few": (changed_row(goal=lambda one: one.goal[1:]), "answers", "the layout returned goal of shape"),
    "a flat wall": (
        changed_row(obstacles=lambda one: np.zeros((2, 2))),
        "answers",
        "obstacles of shape [2, 2] instead of [any number, any number, 2]",
    ),
    "nowhere": (changed_row(goal=lambda one: one.goal * np.nan), "answers", "the vehicle the goal [nan, nan]"),
    "a heap": (changed_row(start=lambda one: one.start * 0.5), "answers", "agents 0 and 1 overlap by 0.1 m"),
    "nothing to do": (
        changed_row(goal=lambda one: one.start + 0.1),
        "answers",
        "the vehicle starts 0.141 m from its goal",
    ),
    "a pedestrian with nothing to do": (
        changed_row(goal=lambda one: np.vstack([one.goal[:1], one.start[1:]])),
        "answers",
        "in case val/0, pedestrian 1 starts at its goal",
    ),
    "a wall through people": (
        changed_row(obstacles=lambda one: np.array([[[-1.0, 0.2], [9.0, 0.2]]])),
        "answers",
        "the start of the vehicle, [0.0, 0.0], is 0.2 m from obstacles[0]",
    ),
    "a box around a goal": (
        changed_row(obstacles=lambda one: box(one.goal[0], 0.5)),
        "answers",
        "no way leads the vehicle from (0, 0) to its goal",
    ),
    "a route through a wall": (
        changed_row(
            obstacles=lambda one: np.array([[[-3.0, 3.0], [0.5, 3.0]]]),
            route=lambda one: np.full((len(one.start), 1, 2), np.nan),
        ),
        "answers",
        "the route of the vehicle leads 0 m past an obstacle",
    ),
    "NumPy's dice": (
        changed_row(goal=lambda one: one.goal + np.random.rand()),  # noqa: NPY002 (the fault)
        "repeatable",
        "draw random numbers only from the stream of the case",
    ),
    "Python's dice": (changed_row(goal=lambda one: one.goal + random.random()), "repeatable", "first in case 0"),
    "dice of its own": (
        changed_row(goal=lambda one: one.goal + LATER.random()),
        "repeatable",
        "differ when it is asked again",
    ),
}


def plain(self, start, goal, route=None, obstacles=None):
    for name, value in (("start", start), ("goal", goal), ("route", route), ("obstacles", obstacles)):
        object.__setattr__(self, name, value)


def layout_faults(layout, place=PLACE, cases=CASES):
    starts = dataclasses.replace(place.starts, layout=LayoutCall(layout))
    changed = dataclasses.replace(place, starts=starts)
    faults = broken(results_of(Subject(SCENARIO, lambda: changed, "mine", {"": changed}, neural=False), cases))
    faults.pop("arrivals", None)  # the episodes are too short for anybody to arrive
    return faults


def test_what_groups_make_of_a_layout_is_examined_by_what_a_run_does():
    def alley(rng, radius, preferred_speed):
        """A lane of 1.2 m, in which there is no room for two abreast."""
        place = np.arange(len(radius)) * 2.0
        start, goal = np.stack([place, 0.0 * place], axis=1), np.stack([place + 60.0, 0.0 * place], axis=1)
        sides = [[[-5.0, side], [80.0, side]] for side in (-0.6, 0.6)]
        walls = np.array([*sides, *([[end, -0.6], [end, 0.6]] for end in (-5.0, 80.0))])
        return Placement(start, goal, obstacles=walls)

    def faults(groups):
        place = load_scenario("circle_crossing_5", {"time_limit": 3.5, **groups})
        return layout_faults(alley, place, Cases.parse("val:2"))

    assert not faults({})
    said = faults({"pedestrians.groups": {"2": 1.0}})["answers"]
    assert "the start of pedestrian" in said
    assert "the layout placed its group; members stand side by side around that place" in said


@pytest.mark.parametrize("name", LAYOUTS_THAT_OFFEND)
def test_a_fault_of_a_layout_is_found(name, monkeypatch):
    # Without the checks of the tests, which would be an exception in the layout.
    monkeypatch.setattr(Placement, "__init__", plain)
    layout, check, expected = LAYOUTS_THAT_OFFEND[name]
    faults = layout_faults(layout)
    assert check in faults
    assert expected in faults[check]


def test_good_layouts_pass():
    regions = {"left": [[-9.0, -6.0], [-3.0, 6.0]], "right": [[3.0, -6.0], [9.0, 6.0]]}
    plan = functools.partial(floor_plan, regions=regions, vehicle=["left", "right"], ways=[["left", "right"]])
    for layout in [row_of_people, plan, *(layout for layout in LAYOUTS.values() if layout is not floor_plan)]:
        assert not layout_faults(layout, cases=Cases.parse("val:2"))


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
    answers = {"policy": "velocities", "predictor": "predictions", "metric": "values", "planner": "commands"}
    (tmp_path / "mine.py").write_text(FILES[function])
    done = command(str(tmp_path / "mine.py"))
    assert done.exit_code == 0, done.output
    assert answers[function] in done.output


def test_a_file_of_two_kinds_or_of_none_is_told(tmp_path):
    both = tmp_path / "both.py"
    both.write_text(FILES["planner"] + FILES["policy"])
    message = str(command(str(both)).exception)
    assert "defines planner() and policy(): say which is meant, with --kind planners or --kind pedestrians" in message
    assert "velocities" in command(str(both), "--kind", "pedestrians").output
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
        (
            ("length", "--kind", "metrics"),
            "no metric is called 'length' (did you mean path_length?); there are success_rate, ",
        ),
        (("orca", "--kind", "pedestrians", "--option", "a=1"), "a pedestrian policy, which has no options"),
    ],
)
def test_what_cannot_be_checked_is_told(arguments, message):
    assert message in str(command(*arguments).exception)


def reward_faults(reward):
    place = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 6.0})
    return broken(results_of(Subject(REWARD, lambda: reward, "mine", {"": place}, neural=False), Cases.parse("val:4")))


@pytest.mark.parametrize("name", REWARDS.functions)
def test_rewards_that_ship_keep_their_contract(name):
    assert not reward_faults(REWARDS.find(name)[1])


def write(step):
    step.gap[:] = 0.0
    return step.progress


def remember(step, calls=[]):  # noqa: B006
    calls.append(step)
    return step.progress + len(calls)


@pytest.mark.parametrize(
    ("reward", "checks"),
    [
        (lambda step: 1 / 0, {"answers"}),
        (lambda step: step.progress[:-1], {"answers"}),
        (lambda step: np.full(len(step), np.nan), {"answers"}),
        (write, {"answers"}),
        (remember, {"repeatable"}),
        (lambda step: step.progress - step.progress.mean(), {"independent"}),
    ],
)
def test_a_fault_of_a_reward_is_found(reward, checks):
    assert checks <= set(reward_faults(reward))


@pytest.mark.slow
def test_a_scenario_is_started_and_driven(tmp_path):
    place = load_scenario("circle_crossing_5")
    results = results_of(Subject(SCENARIO, lambda: place, "mine", {"": place}), Cases.parse("val:2"))
    assert "driven by ORCA: " in results["answers"].observation
    assert not broken(results)
    text = Path("scenarios/suite/corridor_8.toml").read_text()
    (tmp_path / "full.toml").write_text(text.replace("number = 8", "number = 40"))
    found = CliRunner().invoke(app, ["check", str(tmp_path / "full.toml"), "--cases", "val:2"])
    assert found.exit_code == 1
    assert "finds no room" in found.output


def test_a_scenario_is_checked_as_its_file_says(tmp_path):
    failed = CliRunner().invoke(app, ["check", "./mine.toml", "--scenario", "doorway_10"])
    assert "leave out --option and --scenario" in str(failed.exception)
    missing = CliRunner().invoke(app, ["check", str(tmp_path / "mine.toml")])
    assert "mine.toml" in str(missing.exception)


def test_a_planner_is_checked_with_its_filter():
    found = CliRunner().invoke(app, ["check", "orca", "--option", "filter=kalman", "--cases", "val:2"])
    assert found.exit_code == 0
    assert "broken" not in found.output
