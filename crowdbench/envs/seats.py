"""One world as each of its agents has it, so that what is written for the vehicle serves pedestrians too."""

from __future__ import annotations

import dataclasses

import numpy as np

from crowdbench.types import PERFECT, World

_OF_AGENTS = ("position", "velocity", "origin", "goal", "route", "waypoint", "radius", "preferred_speed")


def seats(world: World) -> World:
    """A world for each agent of one world, in which that agent is agent 0 and the others follow in their order.

    A pedestrian's world lacks a vehicle that is not visible. Everybody sees everybody exactly and at once: a sensor is
    the vehicle's alone. Headings, histories, persons, groups, policies, parameters and memories are those of the world
    as it was: they are of the vehicle and of the pedestrians in their own order.

    Args:
        world: One world.

    Returns:
        As many worlds as it has agents.
    """
    agents = world.radius.shape[1]
    order = np.arange(agents)
    seat = np.where(order[None] == 0, order[:, None], order - (order[None] <= order[:, None]))
    worlds = world.take(np.zeros(agents, np.int64))
    present = world.present[0][seat]
    present[1:, 1] &= world.rules.visible
    rules = world.rules if world.rules.sensor == PERFECT else dataclasses.replace(world.rules, sensor=PERFECT)
    ordered = {name: getattr(world, name)[0][seat] for name in _OF_AGENTS}
    return worlds.replace(present=present, rules=rules, sight={}, **ordered)
