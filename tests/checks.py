"""Checks of plug-ins, and their results."""

import dataclasses

from crowdbench.catalog import load_scenario
from crowdbench.check import check_plugin
from crowdbench.check.checks import Subject
from crowdbench.check.drives import POLICY
from crowdbench.scenario.cases import Cases

# Crowds of several sizes, so that there is padding, in short episodes.
PLACE = load_scenario("circle_crossing_mixed", {"vehicle.visible": True, "time_limit": 3.5})
CASES = Cases.parse("val:5")


def results_of(subject, cases=CASES):
    return {result.name: result for result in check_plugin(subject, cases)}


def broken(results):
    """The sentences of the checks that have failed, by their names."""
    assert all(result.observation for result in results.values())
    return {name: result.observation for name, result in results.items() if result.passed is False}


def policy_faults(make, neural=False, limit=60.0, place=PLACE):
    place = dataclasses.replace(place, policies={"orca": make()})
    return broken(results_of(Subject(POLICY, make, "orca", {"": place}, limit, neural=neural)))
