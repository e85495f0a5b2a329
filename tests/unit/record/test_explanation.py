"""Three sentences on each failure, from the trace and from what the planner has logged."""

import dataclasses
import re

import numpy as np
import pytest
from helpers import drive, trace

from crowdbench.api import rollout
from crowdbench.catalog import load_scenario
from crowdbench.core.types import Outcome
from crowdbench.record import explanation
from crowdbench.record.explanation import describe_failure
from crowdbench.record.recorded_cases import read_recorded
from crowdbench.record.write import Recorder

STEPS = 8


def head_on(outcome=Outcome.COLLISION):
    """The vehicle drives up at 1 m/s, and pedestrian 1 comes towards it at 1 m/s until their rims touch."""
    time = 0.25 * np.arange(STEPS + 1)[:, None]
    vehicle, other = time * [0.0, 1.0], np.broadcast_to([5.0, 5.0], (STEPS + 1, 2))
    toward = np.array([0.0, 4.55]) - time * [0.0, 1.0]
    made = trace(np.stack([vehicle, other, toward], axis=1), outcome, gap=[*np.arange(3.0, 0.0, -0.5), 0.2, -0.05])
    made.velocity[0, :, 0], made.velocity[0, :, 2] = [0.0, 1.0], [0.0, -1.0]
    return made


def test_a_collision_names_whom_when_and_whose_fault():
    first, expected, done = describe_failure(head_on(), 0)
    fault = "the vehicle is at fault, because it made 50 % of the approach (10 % or more counts)."
    assert first == f"Collision with pedestrian 1 at 2 s: {fault}"
    assert expected == "Contact was predictable at constant velocity a second earlier."
    assert "pedestrian 1 turned by 0° and went from 1.0 to 1.0 m/s, the vehicle from 1.0 to 1.0 m/s" in done
    assert "had seen the pedestrian all the time" in done


def test_the_planners_own_prediction_is_compared_with_what_happened():
    made = head_on()
    # Three modes expect pedestrian 1 at the side, one of them much farther; the last decision is right.
    predicted = np.full((1, STEPS, 3, 6, 2, 2), np.nan)
    for step in range(STEPS):
        predicted[0, step, :, :, 1] = (
            made.position[0, STEPS, 0] + np.array([[1.0, 0.0], [1.2, 0.0], [9.0, 0.0]])[:, None]
        )
    predicted[0, STEPS - 1, :, :, 1] = made.position[0, STEPS, 2]
    told = describe_failure(dataclasses.replace(made, logs={"predicted": predicted}), 0)[1]
    assert told == "Contact was predictable by the planner 0.25 s earlier."
    predicted[0, STEPS - 1, :, :, 1] += [1.0, 0.0]
    told = describe_failure(dataclasses.replace(made, logs={"predicted": predicted}), 0)[1]
    gap = np.hypot(1.0, 0.55) - float(made.radius[0, -1, [0, 2]].sum())
    assert told == f"Contact was not predictable: 0.25 s earlier, the gap predicted by the planner was {gap:.2f} m."
    predicted[:] = np.nan
    told = describe_failure(dataclasses.replace(made, logs={"predicted": predicted}), 0)[1]
    assert told == "The pedestrian was not predicted, because the vehicle did not see it."
    other = {"predicted": np.zeros((1, STEPS, 4, 7, 2))}  # no positions of two pedestrians
    assert "constant velocity" in describe_failure(dataclasses.replace(made, logs=other), 0)[1]


def test_a_pedestrian_that_was_seen_late_is_said_to_be():
    made = head_on()
    for unseen, said in ((STEPS - 3, "for 0.5 s"), (STEPS - 1, "only at the contact"), (STEPS, "at the end")):
        seen = np.ones((1, STEPS + 1, 2), bool)
        seen[0, : unseen + 1] = False
        assert said in describe_failure(dataclasses.replace(made, seen=seen), 0)[2]


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (0.0999, "the vehicle is not at fault, because it made 9 % of the approach (10 % or more counts)."),
        (0.1, "the vehicle is at fault, because it made 10 % of the approach (10 % or more counts)."),
        (1.0, "the vehicle is at fault, because it made 100 % of the approach (10 % or more counts)."),
        (np.nan, "the fault is undetermined, because both hardly moved."),
    ],
)
def test_the_threshold_of_fault_stands_beside_the_share(share, said):
    assert explanation._fault(share) == said


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("scenario", "cases", "changes"),
    [
        ("circle_20_blind", "val:200", {}),
        ("circle_20_blind", "val:150", {"sensor.track": "realistic"}),
        ("streets_16", "val:150", {"sensor.track": "realistic"}),
        ("corner_5", "val:150", {}),
        ("circle_crossing_5", "val:50", {"collision_ends": False}),
    ],
)
def test_no_sentence_has_a_negative_number(scenario, cases, changes):
    made = rollout("straight", load_scenario(scenario, changes), cases)
    failed = np.flatnonzero(made.outcome != Outcome.SUCCESS)
    assert len(failed) >= (0 if changes.get("collision_ends") is False else 60)
    for row in failed:
        told = describe_failure(made, row)
        assert len(told) == 3
        for sentence in filter(None, told):
            assert not re.search(r"-\d|nan|inf", sentence), sentence
            assert sentence.endswith(".")


@pytest.mark.parametrize(
    ("outcome", "first"),
    [
        (Outcome.TIMEOUT, "Out of time at 2 s: the vehicle was "),
        (Outcome.WALL_COLLISION, "Collision with an obstacle at 2 s: the vehicle is at fault."),
    ],
)
def test_other_failures_have_three_sentences_too(outcome, first):
    sentences = describe_failure(head_on(outcome), 0)
    assert len(sentences) == 3
    assert sentences[0].startswith(first)
    assert sentences[2] == "The smallest gap to a pedestrian was 0.00 m, at 2 s."
    assert describe_failure(head_on(Outcome.SUCCESS), 0) == []


def test_the_sentences_are_kept_in_a_recording(tmp_path):
    driven = drive("orca", "12")
    about = {"planner": "orca", "scenario": "circle_crossing_5", "scenario_digest": "abc"}
    with Recorder(tmp_path / "run.rrd", **about) as recorder:
        recorder.add(driven, np.arange(10), {})
    assert {int(outcome) for outcome in driven.outcome[:10]} >= {Outcome.SUCCESS, Outcome.COLLISION}
    for case in range(10):
        assert read_recorded(tmp_path / "run.rrd", case).verdict == describe_failure(driven, case)
    assert read_recorded(tmp_path / "run.rrd", 10) is None
