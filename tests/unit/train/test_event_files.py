"""Training curves for TensorBoard."""

import itertools
import sys
import time
from types import SimpleNamespace

import pytest

from crowdbench.train.event_files import log_curve


def training(*amounts):
    curve = [{"episodes": n, "seconds": n / 10, "loss": 1.0 / n, "success": n / 100} for n in amounts]
    seconds = curve[-1]["seconds"] if curve else 0.0
    return SimpleNamespace(config=SimpleNamespace(length="episodes"), curve=curve, seconds=seconds)


def read(directory):
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = accumulators.EventAccumulator(str(directory))
    events.Reload()
    return {name: events.Scalars(name) for name in events.Tags()["scalars"]}


def test_each_validation_is_a_step_of_its_scalars(tmp_path):
    running = training()
    with log_curve(tmp_path, running) as log:
        for amount in (10, 20, 40):
            running.curve = training(*[point["episodes"] for point in running.curve], amount).curve
            log()
            assert [point.step for point in read(tmp_path)["loss"]][-1] == amount  # at once
    scalars = read(tmp_path)
    assert scalars.keys() == {"seconds", "loss", "success"}
    assert [point.step for point in scalars["success"]] == [10, 20, 40]
    assert [point.value for point in scalars["success"]] == pytest.approx([0.1, 0.2, 0.4])
    times = [point.wall_time for point in scalars["loss"]]
    assert [after - before for before, after in itertools.pairwise(times)] == pytest.approx([1.0, 2.0])


def test_a_resumed_training_continues_the_curve_and_repeats_no_step(tmp_path):
    with log_curve(tmp_path, before := training(10)) as log:
        before.curve = training(10, 20, 25).curve  # the point 25 is later than the last checkpoint
        log()
    with log_curve(tmp_path, resumed := training(10, 20)) as log:
        resumed.curve = training(10, 20, 30).curve
        log()
    assert len(list(tmp_path.iterdir())) == 1
    points = read(tmp_path)["loss"]
    assert [point.step for point in points] == [10, 20, 30]
    assert points[1].wall_time == pytest.approx(time.time(), abs=60.0)


def test_without_tensorboard_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with log_curve(tmp_path, training(10)) as log:
        log()
    assert list(tmp_path.iterdir()) == []
