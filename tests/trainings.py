"""Trainings of seconds, and listeners to them."""

import dataclasses

import pytest

from crowdbench.scenario.cases import Cases
from crowdbench.train import driving
from crowdbench.train.config import METHODS
from crowdbench.train.runner import Runner


class Killed(Exception):
    """Stops a training, as a signal would."""


def ignore(*arguments):
    """A listener that does nothing."""


def shorten(monkeypatch, module, cases, **sizes):
    """Set sizes of a method, and the number of cases of a validation and of a card's split."""
    for name, size in sizes.items():
        monkeypatch.setattr(module, name, size)
    monkeypatch.setattr(driving, "VALIDATION_CASES", Cases("val", 0, cases))
    splits = {split: dataclasses.replace(part, stop=part.start + cases) for split, part in driving.CASES.items()}
    monkeypatch.setattr(driving, "CASES", splits)


def train(config, directory):
    """A runner that has trained to the end."""
    runner = Runner.start(config, directory, "cpu")
    runner.train(ignore)
    return runner


def kill(config, directory, points):
    """Stop a training after a number of points of its curve."""
    seen = []

    def listen(*point):
        seen.append(point)
        if len(seen) == points:
            raise Killed

    with pytest.raises(Killed):
        Runner.start(config, directory, "cpu").train(listen)


def resume(directory, methods=METHODS):
    """A runner that has resumed a training and trained to the end."""
    runner = Runner.resume(directory, "cpu", methods=methods)
    assert runner.training.progress < 1.0
    runner.train(ignore)
    return runner


def untimed(training):
    """The curve without times."""
    return [dataclasses.replace(point, seconds=0.0) for point in training.curve]
