"""The social force model (Helbing and Molnár 1995), with the paper's parameters.

Helbing and Molnár, "Social force model for pedestrian dynamics", Physical Review E 51, 1995. The size of the
fluctuation is ours, because the paper gives none. In groups, the forces of Moussaïd et al. (2010) are added.
"""

from crowdbench.sim import SocialForce


def policy() -> SocialForce:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.social_force]`.

    Parameters:
        relaxation_time: Time in which a pedestrian regains its preferred velocity: the paper's tau [s].
        repulsion_strength: Height of the repulsive potential around other pedestrians: the paper's V0 [m^2/s^2].
        repulsion_range: Distance over which that potential falls by a factor of e: the paper's sigma [m].
        look_ahead: Time for which others are expected to keep their velocity: the paper's Delta t [s].
        sight_angle: Angle within which others count in full: the paper's 2 phi [rad].
        behind_weight: Weight of others outside of the sight angle: the paper's c [1].
        wall_strength: Height of the repulsive potential of obstacles: the paper's U0 [m^2/s^2].
        wall_range: Distance over which that potential falls by a factor of e: the paper's R [m].
        group_gaze: Slowing of a member ahead of its group: beta 1 of Moussaïd et al. [1/(rad s)].
        group_attraction: Attraction to the centre of a group: beta 2 of Moussaïd et al. [m/s^2].
        group_repulsion: Repulsion between members of a group that are too near: beta 3 of Moussaïd et al. [m/s^2].
        fluctuation: Standard deviation of a single pedestrian's lateral velocity [m/s].

    Returns:
        The policy.
    """
    return SocialForce()
