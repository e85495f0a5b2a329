"""Small worlds and traces built by hand."""

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.check import check_plugin
from crowdbench.core.types import Outcome, Rules, Trace, World
from crowdbench.metrics.registry import METRICS
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.results.result_file import digest_of, write_result
from crowdbench.results.run_result import RunResult
from crowdbench.runs.identity import PlannerId
from crowdbench.runs.loading import load_stored_scenario
from crowdbench.runs.make import make_run
from crowdbench.runs.replay import stored_traces
from crowdbench.runs.rollout import rollout
from crowdbench.runs.run import Run
from crowdbench.runs.spec import Replanning, RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.sim import episode
from crowdbench.sim.kernels import writable
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.pedestrians.forces import TINY, Walkers
from crowdbench.sim.simulator import After, Before, crowd_velocities, move
from crowdbench.sim.simulator import step as take_step


def fixture(name):
    """The file of a scenario that tests alone need."""
    return str(Path(__file__).parent / "scenarios" / f"{name}.toml")


def world(position, velocity=None, goal=None, *, radius=0.3, step=0, rules=Rules()):  # noqa: B008 (immutable)
    """One world with the given agents, the vehicle first, all present."""
    position = np.array([position], float)
    shape = position.shape[:2]
    return World.create(
        position=position,
        velocity=np.zeros_like(position) if velocity is None else np.array([velocity], float),
        goal=position + 100.0 if goal is None else np.array([goal], float),
        step=np.array([step]),
        radius=np.full(shape, radius),
        parameters={"orca": {name: np.full(shape, value) for name, value in ORCA.parameters.items()}},
        rules=rules,
    )


def advance(world, command):
    """Worlds after a step of motion: `command` is that of the vehicle, then the velocities of pedestrians."""
    return move(world, command[:, 0], command[:, 1:])[0]


def check_step(before, after):
    """What the check of a step finds, of the worlds before and after it."""
    number = len(before)
    check = episode.StepCheck(np.empty(number, np.int64), np.empty(number), np.empty(number))
    arrays = [
        kind(*(getattr(world, name) for name in kind._fields)) for kind, world in ((Before, before), (After, after))
    ]
    episode.check_step(before.rules.numbers, *arrays, check)
    return check


def trace(position, outcome=Outcome.SUCCESS, *, gap=None, goal=None, undisturbed=None, dt=0.25):
    """One episode from its positions `[time, agent, 2]`, padded as a rollout pads it; radii 0.3, speeds 1."""
    position = np.array(position, float)
    steps, agents = len(position) - 1, position.shape[1]
    rules = Rules(dt=dt)
    velocity = np.diff(position, axis=0, prepend=position[:1]) / dt

    def padded(values, length):
        return np.pad(values, [(0, length - len(values))] + [(0, 0)] * (values.ndim - 1), constant_values=np.nan)[None]

    def always(values):
        return np.broadcast_to(values, (1, rules.max_steps + 1, *values.shape))

    return Trace(
        split="test",
        case=np.array([0]),
        outcome=np.array([int(outcome)]),
        steps=np.array([steps]),
        position=padded(position, rules.max_steps + 1),
        velocity=padded(velocity, rules.max_steps + 1),
        heading=padded(np.zeros(steps + 1), rules.max_steps + 1),
        command=padded(velocity[1:, 0], rules.max_steps),
        wall_gap=padded(np.full(steps, np.inf), rules.max_steps),
        gap=padded(np.full(steps, 1.0) if gap is None else np.array(gap, float), rules.max_steps),
        goal=always(position[-1] if goal is None else np.array(goal, float)),
        radius=always(np.full(agents, 0.3)),
        preferred_speed=np.ones((1, agents)),
        present=always(np.ones(agents, bool)),
        person=always(np.arange(agents - 1)),
        route=np.empty((1, 0, 2)),
        obstacles=np.empty((1, 0, 0, 2)),
        seen=always(np.ones(agents - 1, bool)),
        rules=rules,
        undisturbed=None if undisturbed is None else padded(np.array(undisturbed, float), rules.max_steps + 1),
    )


def drive(
    planner, cases="20", scenario="circle_crossing_5", decision_limit=60.0, replan_every=1, look_first=1, **overrides
):
    """A trace of a planner, by name or as an object; overrides use `__` for dots."""
    name, made = (planner, load_planner(planner)) if isinstance(planner, str) else (type(planner).__name__, planner)
    place = load_scenario(scenario, {key.replace("__", "."): value for key, value in overrides.items()})
    replanning = Replanning(replan_every, look_first)
    return rollout(Driver(made, name, decision_limit), place, Cases.parse(cases), replanning=replanning)


def run_of(planner, scenario, cases, *, metrics=METRICS, **asked):
    """A run of a planner, by name or as an object, which is called `mine`; other arguments are those of `RunSpec`."""
    name, made = (planner, load_planner(planner)) if isinstance(planner, str) else ("mine", planner)
    spec = RunSpec(name, scenario.name, Cases.parse(cases), **asked)
    key = "" if isinstance(planner, str) else "mine"
    return Run(spec, Driver(made, name), scenario, metrics, PlannerId(name, spec.options, key=key))


MAKING = ("shard", "overwrite", "drive", "progress")


def make(out, *run, **settings):
    """Make the run that `run_of` describes; some of the arguments are those of `make_run`."""
    making = {name: settings.pop(name) for name in MAKING if name in settings}
    return make_run(run_of(*run, **settings), out, **making)


def reseal(directory, change=lambda result: None):
    """Change `result.json`, and make its id and the digests of all files fit, as a forger would."""
    result = json.loads((directory / "result.json").read_text())
    change(result)
    result["id"] = digest_of(result["run"])
    write_result(directory, result)


def to_walkers(position, velocity, goal, radius, preferred_speed, seen=None, moves=None, obstacles=None):
    """Agents as the kernels of force models take them; without `seen` or `moves` all are seen, or move."""
    seen, moves = (np.ones(radius.shape, np.bool_) if array is None else array for array in (seen, moves))
    walls = np.empty((len(radius), 0, 0, 2)) if obstacles is None else obstacles
    speed = np.maximum(preferred_speed, TINY)
    return Walkers(*map(writable, (position, velocity, goal, radius, speed, seen, moves, walls)))


def with_walkers(velocities, known, *inputs, **options):
    """The velocities of a force model, with agents, obstacles and the known parameters as arguments."""

    def pop(names):
        return {name: options.pop(name) for name in options.keys() & set(names)}

    parameters, walkers = pop(known), to_walkers(*inputs[:5], **pop(Walkers._fields))
    return velocities(walkers, *inputs[5:], **options, parameters=parameters)


def same(one, two):
    """Whether two traces hold the same bits."""
    names = [field.name for field in dataclasses.fields(Trace) if field.name not in ("split", "rules", "logs")]
    pairs = [(getattr(one, name), getattr(two, name)) for name in names]
    return all(a is b is None or np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def worlds_of(changes, n=4, steps=14, scenario="circle_crossing_mixed"):
    """The worlds of some cases, step by step, while the vehicle drives on."""
    place = load_scenario(scenario, changes)
    now = place.worlds(Cases("val", 0, n))
    for _ in range(steps):
        yield now
        crowd = crowd_velocities(now, place.policies)
        now, _ = take_step(now, np.tile([0.1, 0.6], (n, 1)), crowd)


class Still(Planner):
    """Stands where it is."""

    def plan(self, obs):
        return np.zeros((len(obs), 2))


def failed_checks(subject, cases="val:3"):
    """The sentences of the checks of a plug-in's contract that have failed, by their names."""
    results = check_plugin(subject, Cases.parse(cases))
    assert all(result.observation for result in results)
    return {result.name: result.observation for result in results if not result.passed}


def stored_trace(directory, **files):
    """The trace of a stored run, simulated again from its commands or read from its tracks."""
    (found,) = stored_traces(RunResult.read(directory), functools.partial(load_stored_scenario, **files))
    return found
