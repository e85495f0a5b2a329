"""The power law of the time to collision (Karamouzas et al. 2014), with the paper's parameters.

Karamouzas, Skinner and Guy, "Universal Power Law Governing Pedestrian Interactions", Physical Review Letters 113, 2014.
No planner that comes along was trained among its pedestrians: it is held out for tests.
"""

from crowdbench.sim.pedestrians import PowerLaw


def policy() -> PowerLaw:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.power_law]`.

    Parameters:
        relaxation_time: Time in which a pedestrian regains its preferred velocity: xi in the authors' code [s].
        interaction_energy: The paper's k: the energy per mass of a collision that is tau ahead is k / tau^2, less
            what the horizon takes off [m^2].
        interaction_horizon: Collisions that are farther ahead hardly count: the paper's tau0 [s].
        max_acceleration: Bound of the sum of the forces of others and walls, of the authors' code [m/s^2].

    Returns:
        The policy.
    """
    return PowerLaw()
