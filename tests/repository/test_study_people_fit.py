"""Fits of pedestrian policies and of their populations to recorded people."""

import json

import pytest
from repository.test_study_people import crossings, recorded_by

from agents.pedestrians.orca_people import ORCAPeople
from crowdbench.utils.errors import InputError
from studies.people.fit import POLICIES, judge, options_of, parameter_bounds, search
from studies.people.fitted import Model, fitted_models, with_populations
from studies.people.likelihood import score
from studies.people.run import Recordings
from studies.people.simulate import simulate


def starts(policy):
    return {name: bounds.start for name, bounds in parameter_bounds(policy).items()}


@pytest.mark.slow
@pytest.mark.parametrize("policy", POLICIES)
def test_every_fitted_parameter_is_an_option_of_the_policy(policy):
    windows = crossings(windows=1)
    places = simulate(policy, windows, options_of(policy, starts(policy)), rollouts=2)
    others = simulate(policy, windows, {}, rollouts=2)
    assert (places[0] != others[0]).any()


def test_the_generating_parameters_are_better_than_distant_ones():
    near = starts("orca_people") | {"noise": 0.05}
    far = near | {"noise": 0.5}
    windows = recorded_by("orca_people", crossings(), options_of("orca_people", near))
    assert judge("orca_people", windows, near) > judge("orca_people", windows, far)


@pytest.mark.slow
def test_a_search_is_never_worse_than_its_first_trials_and_repeats_itself():
    windows = recorded_by("straight", crossings(windows=2))
    bounds = parameter_bounds("straight")
    best, value = search("straight", windows, bounds, generations=2)
    assert (best, value) == search("straight", windows, bounds, generations=2)
    assert value == judge("straight", windows, best)
    assert value >= search("straight", windows, bounds, generations=1)[1]
    assert all(bounds[name].low <= number <= bounds[name].high for name, number in best.items())


def test_each_location_has_the_options_that_were_fitted_without_it(tmp_path):
    for name, horizon in (("hotel", 1.0), ("univ", 4.0)):
        (tmp_path / f"{name}.json").write_text(json.dumps({"policy": "orca", "options": {"time_horizon": horizon}}))
    windows = {"hotel": crossings(windows=1), "confirmation": crossings(windows=1, seed=1)}
    models = fitted_models(tmp_path, windows)
    horizons = {name: model.options["time_horizon"] for name, model in models.items()}
    assert horizons == {"hotel": 1.0, "confirmation": 4.0}  # a place with `univ`
    found = Recordings(windows, simulate, score, None).score_models(models)["shown"]
    expected = [score(each, simulate("orca", each, models[name].options))[0] for name, each in windows.items()]
    assert [one.log for one in found] == [one.log for one in expected]
    assert found[1].log != score(windows["confirmation"], simulate("orca", windows["confirmation"]))[0].log


def test_another_policy_has_the_population_of_each_model():
    models = {"hotel": Model("orca_people"), "univ": Model("orca_people", {"population.noise": 0.5})}
    blind = with_populations("straight", models)
    assert [one.policy for one in blind.values()] == ["straight", "straight"]
    noise = [one.options["pedestrians.population"]["noise"] for one in blind.values()]
    assert noise == [ORCAPeople.population["noise"], 0.5]
    assert with_populations("straight", {"hotel": Model("orca")}) == {}


@pytest.mark.parametrize("content", [None, "{", "[]", "{}"])
def test_a_missing_and_a_wrong_file_of_a_fit_get_one_sentence(content, tmp_path):
    if content is not None:
        (tmp_path / "zara.json").write_text(content)
    with pytest.raises(InputError, match=r"zara\.json.*run .* --held-out zara$"):
        fitted_models(tmp_path, ["zara"])
