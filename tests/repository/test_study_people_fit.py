"""Fits of pedestrian policies and of their populations to recorded people."""

import pytest
from repository.test_study_people import crossings, recorded_by

from studies.people.fit import POLICIES, judge, options_of, parameter_bounds, search
from studies.people.simulate import simulate


def starts(policy):
    return {name: bounds.start for name, bounds in parameter_bounds(policy).items()}


@pytest.mark.parametrize("policy", POLICIES)
def test_every_fitted_parameter_is_an_option_of_the_policy(policy):
    windows = crossings(windows=1)
    places = simulate(policy, windows, options_of(policy, starts(policy)), rollouts=2)
    others = simulate(policy, windows, {}, rollouts=2)
    assert (places[0] != others[0]).any()


def test_the_generating_parameters_are_better_than_distant_ones():
    near = starts("orca") | {"noise": 0.05}
    far = near | {"noise": 0.5}
    windows = recorded_by("orca", crossings(), options_of("orca", near))
    assert judge("orca", windows, near) > judge("orca", windows, far)


@pytest.mark.slow
def test_a_search_is_never_worse_than_its_first_trials_and_repeats_itself():
    windows = recorded_by("straight", crossings(windows=2))
    bounds = parameter_bounds("straight")
    best, value = search("straight", windows, bounds, generations=2)
    assert (best, value) == search("straight", windows, bounds, generations=2)
    assert value == judge("straight", windows, best)
    assert value >= search("straight", windows, bounds, generations=1)[1]
    assert all(bounds[name].low <= number <= bounds[name].high for name, number in best.items())
