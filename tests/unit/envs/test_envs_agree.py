"""The same case and commands give the same episode, to the last bit, in every environment and in a rollout."""

import numpy as np
import pytest
from helpers import drive

from crowdbench.core.reward import reward
from crowdbench.core.types import Outcome
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.views.ego import flatten

CASES = 5
EXACT = {"action": "velocity", "dtype": "float64"}
SCENARIOS = ["circle_crossing_5", "circle_crossing_5_visible", "circle_crossing_5_social_force", "square_crossing_5"]


class Recorder(Planner):
    """Drives with ORCA and keeps what it has seen, flattened."""

    def __init__(self):
        self.orca = ORCAPlanner()
        self.seen = {}

    def plan(self, obs):
        for case, features in zip(obs.row.tolist(), flatten(obs), strict=True):
            self.seen.setdefault(case, []).append(features)
        return self.orca.plan(obs)


@pytest.fixture(scope="module", params=SCENARIOS)
def recorded(request):
    planner = Recorder()
    trace = drive(planner, str(CASES), request.param)
    return request.param, trace, planner.seen


def ending(trace, row):
    """The reward of each step, and the info of the last."""
    steps = trace.steps[row]
    outcome = np.zeros(steps, int)
    outcome[-1] = trace.outcome[row]
    gap, last = trace.gap[row, steps - 1], int(outcome[-1])
    info = {"outcome": last, "is_success": last == Outcome.SUCCESS, "gap": gap, "case": trace.case[row]}
    return reward(outcome, trace.gap[row, :steps], trace.rules.dt), info


def test_gymnasium_gives_the_episode_of_a_rollout(recorded):
    scenario, trace, seen = recorded
    env = VehicleEnv(scenario, **EXACT)
    for row, case in enumerate(trace.case.tolist()):
        obs, _ = env.reset(options={"case": f"test/{case}"})
        rewards = []
        for step in range(trace.steps[row]):
            assert np.array_equal(obs, seen[case][step])
            obs, paid, terminated, truncated, info = env.step(trace.velocity[row, step + 1, 0])
            rewards.append(paid)
            assert (terminated or truncated) == (step == trace.steps[row] - 1)
        expected, ended = ending(trace, row)
        assert rewards == expected.tolist()
        assert info == ended
        assert env.case == f"test/{case}"


def test_the_vector_environment_gives_the_episodes_of_a_rollout(recorded):
    scenario, trace, seen = recorded
    env = VehicleVectorEnv(CASES, scenario, **EXACT)
    obs, _ = env.reset(options={"case": [f"test/{case}" for case in trace.case.tolist()]})
    returns = np.zeros(CASES)
    for step in range(trace.steps.max()):
        running = step < trace.steps
        for row in np.flatnonzero(running).tolist():
            assert np.array_equal(obs[row], seen[trace.case[row]][step])
        commands = np.where(running[:, None], trace.velocity[:, step + 1, 0], 0.0)
        obs, paid, terminated, truncated, infos = env.step(commands)
        returns[running] += paid[running]
        assert np.array_equal((terminated | truncated)[running], (step == trace.steps - 1)[running])
        for row in np.flatnonzero(step == trace.steps - 1).tolist():
            assert {name: infos[name][row] for name in ending(trace, row)[1]} == ending(trace, row)[1]
    assert returns == pytest.approx([ending(trace, row)[0].sum() for row in range(CASES)], abs=1e-12)


@pytest.mark.parametrize("given", [(), (1, 3, 4, 5)])
def test_pettingzoo_gives_the_episode_of_a_rollout_whoever_is_commanded(recorded, given):
    scenario, trace, seen = recorded
    env = parallel_env(scenario, **EXACT)
    names = env.possible_agents
    for row, case in enumerate(trace.case.tolist()):
        observations, _ = env.reset(options={"case": f"test/{case}"})
        for step in range(trace.steps[row]):
            assert np.array_equal(observations["vehicle"], seen[case][step])
            commands = {names[agent]: trace.velocity[row, step + 1, agent] for agent in (0, *given)}
            observations, rewards, terminated, truncated, infos = env.step(
                {agent: command for agent, command in commands.items() if agent in env.agents}
            )
            assert np.array_equal(env._world.position[0], trace.position[row, step + 1])
        expected, ended = ending(trace, row)
        assert rewards["vehicle"] == expected[-1]
        assert infos["vehicle"] == ended
        assert env.agents == []
        assert set(truncated.values()) == {ended["outcome"] == Outcome.TIMEOUT}
        assert terminated["vehicle"] == (ended["outcome"] != Outcome.TIMEOUT)
