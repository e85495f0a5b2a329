"""The power law of the time to collision with parameters that were fitted to recorded people, see studies/people.

Power law: Karamouzas et al. 2014. Data: ETH/UCY (Pellegrini et al. 2009, Lerner et al. 2007).
"""

from collections.abc import Mapping
from typing import Any, ClassVar

from agents.pedestrians.power_law import PARAMETERS, PowerLaw


class PowerLawPeople(PowerLaw):
    """The power law for people: they differ in the strength and the horizon of avoidance, and their intentions vary."""

    parameters: ClassVar[Mapping[str, float]] = {**PARAMETERS, "interaction_energy": 0.106, "interaction_horizon": 0.96}
    population: ClassVar[Mapping[str, Any]] = {
        "noise": 0.203,
        "noise_time": 0.77,
        "inertia": 0.72,
        "shrinkage": 0.025,
        "spread": {"preferred_speed": 0.124, "inertia": 0.3, "interaction_energy": 0.656, "interaction_horizon": 0.656},
    }


def policy() -> PowerLawPeople:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.power_law_people]`.

    Parameters:
        relaxation_time: Time within which a pedestrian reaches its desired velocity [s].
        interaction_energy: Energy of interaction: the paper's k [m^2].
        interaction_horizon: Time beyond which interaction decreases exponentially: the paper's tau0 [s].
        max_acceleration: Bound of the sum of the forces of other agents and walls [m/s^2].

    Returns:
        The policy.
    """
    return PowerLawPeople()
