"""Three sentences on each failure, from the trace and from what the planner has logged."""

import dataclasses

import numpy as np
import pytest
from helpers import drive, trace

from crowdbench.core.types import Outcome
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
    assert first == "Collision with pedestrian 1 at 2 s: the vehicle's fault (φ = 0.50, its share of the approach)."
    radii = float(head_on().radius[0, -1, [0, 2]].sum())
    gap = f"{0.55 - radii:.2f} m"
    moments = ", ".join(f"{gap} at {when} s" for when in ("1", "1.5", "1.75"))
    how = "constant velocity; the planner logs no prediction"
    assert expected == f"Gap expected for that moment ({how}): {moments}. Actual gap: -0.05 m."
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
    radii = float(made.radius[0, -1, [0, 2]].sum())
    told = describe_failure(dataclasses.replace(made, logs={"predicted": predicted}), 0)[1]
    assert f"(the planner's prediction): {1.2 - radii:.2f} m at 1 s, {1.2 - radii:.2f} m at 1.5 s, " in told
    assert f"{0.55 - radii:.2f} m at 1.75 s. Actual gap" in told
    predicted[:] = np.nan
    told = describe_failure(dataclasses.replace(made, logs={"predicted": predicted}), 0)[1]
    assert "none, the pedestrian was not seen" in told
    other = {"predicted": np.zeros((1, STEPS, 4, 7, 2))}  # no positions of two pedestrians
    assert "constant velocity" in describe_failure(dataclasses.replace(made, logs=other), 0)[1]


@pytest.mark.parametrize(
    ("outcome", "first"),
    [
        (Outcome.TIMEOUT, "Timeout at 2 s: "),
        (Outcome.WALL_COLLISION, "Collision with an obstacle at 2 s: the vehicle's fault (φ = 1)."),
    ],
)
def test_other_failures_have_three_sentences_too(outcome, first):
    sentences = describe_failure(head_on(outcome), 0)
    assert len(sentences) == 3
    assert sentences[0].startswith(first)
    assert sentences[2] == "The smallest gap to a pedestrian was -0.05 m, at 2 s."
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
