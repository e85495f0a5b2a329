"""The description of metrics: what tables show, and what a run computes for them."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import drive

from crowdbench.metrics.registry import METRICS, UNDISTURBED, MetricInfo, describe, info_of
from crowdbench.metrics.summary import Estimate
from crowdbench.runs.loading import load_run
from crowdbench.runs.run import rollout as loop
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases

INFOS = {name: info_of(name) for name in METRICS}


class Guarded:
    """A trace that notes whether somebody reads `undisturbed`."""

    def __init__(self, trace):
        self.trace, self.was_read = trace, False

    def __getattr__(self, name):
        self.was_read |= name == UNDISTURBED
        return getattr(self.trace, name)

    def __len__(self):
        return len(self.trace)


@pytest.fixture(scope="module")
def episodes():
    return drive("orca", "6", "circle_crossing_5_visible")


@pytest.mark.parametrize("name", METRICS)
def test_every_metric_has_a_unit_a_direction_and_digits(name, episodes):
    info = INFOS[name]
    in_docstring = re.search(r"\[(.+?)\]\.$", METRICS[name].__doc__.partition("\n")[0])[1]
    assert (info.unit or "1") == in_docstring
    # A path is short for who collides, and long for who detours.
    assert (info.sign != 0) == (name not in ("path_length", "paths_apart", "t_empty"))
    assert info.places >= 0
    if METRICS[name](episodes).dtype == bool:
        assert info.share
        assert (info.shown_unit, info.places) == ("%", 1)
    if info.share:
        assert info.unit == ""


def test_metrics_that_read_the_undisturbed_crowd_say_so(episodes):
    assert episodes.undisturbed is not None
    reads = set()
    for name, metric in METRICS.items():
        guarded = Guarded(episodes)
        metric(guarded)
        if guarded.was_read:
            reads.add(name)
    assert reads == {name for name, info in INFOS.items() if UNDISTURBED in info.needs} != set()
    alone = dataclasses.replace(episodes, undisturbed=None)
    for name, metric in METRICS.items():
        if name not in reads:
            np.testing.assert_array_equal(metric(alone), metric(episodes), name)


def plain_metric(trace):
    """How many people there are [1/m]."""
    return trace.present[:, 0, 1:].sum(axis=1)


@describe("people in the world", "more", digits=1)
def described(trace):
    """How many people there are [1]."""
    return plain_metric(trace)


def test_a_metric_of_a_user_has_defaults_or_says_what_it_is():
    assert info_of("plain_metric", metric=plain_metric) == MetricInfo(
        "plain metric", "1/m", needs=frozenset({UNDISTURBED})
    )
    assert info_of("described", metric=described) == MetricInfo("people in the world", "", "more", digits=1)
    assert info_of("slips_rate", is_rate=True).heading == "slips, %"


@pytest.mark.parametrize(
    ("names", "own", "expected"),
    [
        (["jerk"], {}, False),
        (["jerk", "imposed_delay"], {}, True),
        ([], {"mine": plain_metric}, True),
        ([], {"mine": described}, False),
    ],
)
def test_the_crowd_is_simulated_a_second_time_for_those_who_need_it(names, own, expected, monkeypatch):
    asked = []

    def watched(*arguments, undisturbed, **others):
        asked.append(undisturbed)
        return loop(*arguments, undisturbed=undisturbed, **others)

    monkeypatch.setattr("crowdbench.runs.run.rollout", watched)
    run = load_run(RunSpec("orca", "circle_crossing_5", Cases.parse("1"), record="none"))
    run = dataclasses.replace(run, metrics={name: METRICS[name] for name in names} | own)
    out = Path("run")
    monkeypatch.setattr("crowdbench.runs.run.write_run", lambda *arguments, **contents: None)
    monkeypatch.setattr("crowdbench.runs.run.measure", lambda name, metric, trace: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.drive(run.spec.cases, out)
    assert asked == [expected]
    assert not out.exists()


def test_values_are_shown_with_the_digits_and_the_unit_of_their_metric():
    share, time = INFOS["success_rate"], INFOS["navigation_time"]
    assert (share.heading, time.heading) == ("success, %", "time, s")
    assert (share.number(0.998), share.amount(0.998), time.amount(10.5314)) == ("99.8", "99.8 %", "10.531 s")
    estimate = Estimate(0.998, 0.9893, 1.0, 500, 1.0)
    assert share.estimate(estimate) == "99.8 (98.9 to 100.0)"
    assert share.estimate(estimate, with_unit=True) == "99.8 % (98.9 to 100.0)"
    assert share.estimate(Estimate(np.nan, np.nan, np.nan, 0, np.nan)) == share.number(np.nan) == "-"
    assert time.estimate(Estimate(2.0, np.nan, np.nan, 1, 2.0)) == "2.000"
