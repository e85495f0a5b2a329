"""The choice of the clearance to cars."""

import dataclasses

import numpy as np
import pytest
from repository.test_study_people import car, recording, traffic

from studies.people.cars import cut_with_cars
from studies.people.fit_cars import (
    CLEARANCE,
    CLEARANCES,
    FOLDS,
    LOSS,
    MOST_STRUCK,
    NEAREST,
    choose,
    choose_by_folds,
    judge,
    score_with,
)
from studies.people.likelihood import WindowScore
from studies.people.summary import figures
from studies.people.traffic import simulate_traffic
from studies.people.windows import HISTORY


def found(score=0.2, struck=0.0, closest=1.6, recorded=1.6):
    """The score of a window of ten persons."""
    log = dict.fromkeys(("motion", "path", "encounter"), np.log(score))
    return WindowScore(log, 10, 10 * struck, 0, 10, 10 * closest, 10 * recorded)


def test_too_many_struck_persons_and_too_near_approaches_lose():
    assert judge([found()]) == pytest.approx(0.2)
    assert judge([found(struck=MOST_STRUCK)]) == pytest.approx(0.2)
    assert judge([found(struck=2 * MOST_STRUCK)]) == pytest.approx(0.2 - LOSS)
    assert judge([found(closest=1.6 - NEAREST)]) == pytest.approx(0.2)
    assert judge([found(closest=1.6 - 3 * NEAREST)]) == pytest.approx(0.2 - 2 * LOSS)
    assert judge([found(closest=3.0)]) == pytest.approx(0.2)


def test_a_window_has_the_clearance_that_is_best_on_other_clips():
    window = traffic(car((0, -20), (0, 3)))
    names = [f"clip{number:02}" for number in (*range(2 * FOLDS), 0)]
    windows = [dataclasses.replace(window, window=dataclasses.replace(window.window, name=name)) for name in names]
    # One clip is for another clearance, so strongly that it alone decides.
    low, high = CLEARANCES[0], CLEARANCES[-1]
    scores = {each: [found(0.1)] * len(windows) for each in CLEARANCES}
    scores[low] = [found(0.11)] * len(windows)
    scores[high] = [found(0.9 if name == "clip00" else 0.1) for name in names]
    assert choose(scores) == high
    chosen = dict(zip(names, choose_by_folds(scores, windows), strict=True))
    assert {name for name, each in chosen.items() if each == low} == {"clip00", f"clip{FOLDS:02}"}
    assert {chosen[name] for name in names if name not in ("clip00", f"clip{FOLDS:02}")} == {high}


@pytest.mark.slow
def test_the_generating_clearance_is_chosen():
    window = traffic(car((0, -20), (0, 3)), people=((-8.0, 0.9), (1.2, 0.0)))
    policy, options = "orca_people_cars", {"pedestrians.attention.distracted": 0.0}
    (places,) = simulate_traffic(policy, [window], {**options, CLEARANCE: 0.9}, rollouts=4)
    made = []
    for place in places:
        paths = np.concatenate([window.window.position[:HISTORY], place]).swapaxes(0, 1)
        made += cut_with_cars(recording(*paths), window.cars)
    scores = {each: score_with(policy, made, {**options, CLEARANCE: each}) for each in (0.2, 0.9, 2.0)}
    logs = {each: figures(scores[each])["encounter"] for each in scores}
    assert max(logs, key=logs.get) == 0.9
