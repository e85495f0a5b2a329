"""The hybrid planner: a policy drives unless the search finds something much better."""

import numpy as np

from agents.planners.hybrid import HybridPlanner
from crowdbench import load_scenario
from crowdbench.planners.driver import Driver
from crowdbench.planners.mppi import MPPISearch
from crowdbench.planners.planner import Planner
from crowdbench.predict import ConstantVelocity
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

CASES = Cases("val", 0, 3)


class Aside(Planner):
    """Drives past the goal, 30 degrees to the left of it."""

    def plan(self, obs):
        """See `Planner`."""
        x, y = (obs.vehicle.local_goal - obs.vehicle.position).T
        way = np.stack([0.866 * x - 0.5 * y, 0.5 * x + 0.866 * y], axis=1)
        return way / np.linalg.norm(way, axis=1, keepdims=True)


def drive(patience, cases=CASES):
    scenario = load_scenario("circle_crossing_5", {"time_limit": 5.0})
    planner = HybridPlanner(ConstantVelocity(), MPPISearch(samples=40), horizon=8, policy=Aside(), patience=patience)
    return rollout(Driver(planner, "hybrid"), scenario, cases)


def test_with_endless_patience_the_policy_drives_and_without_the_search_does():
    policy = rollout(
        Driver(Aside(), "aside"), load_scenario("circle_crossing_5", {"time_limit": 5.0}), Cases("val", 0, 3)
    )
    np.testing.assert_allclose(drive(np.inf).command[:, 0], policy.command[:, 0], atol=1e-12)
    search = drive(0.0)
    toward = [row @ goal for row, goal in zip(search.command[:, 0], policy.command[:, 0], strict=True)]
    assert max(toward) < 0.97  # not the policy's direction


def test_an_episode_is_the_same_alone_and_in_company():
    together, alone = drive(0.5), drive(0.5, Cases("val", 1, 2))
    steps = alone.command.shape[1]
    np.testing.assert_array_equal(together.command[1, :steps], alone.command[0])
