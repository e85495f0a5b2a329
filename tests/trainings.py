"""Trainings that take seconds, and their listeners."""

import dataclasses

import pytest

from crowdbench.scenario.cases import Cases
from crowdbench.train import driving
from crowdbench.train.config import METHODS
from crowdbench.train.runner import Runner, make_training


class Killed(Exception):
    """Stops a training, as a signal would."""


def ignore(*arguments):
    """A listener that does nothing."""


def shorten(monkeypatch, module, cases, **sizes):
    """Set sizes of a method, and the number of cases of a validation and of a card's split."""
    for name, size in sizes.items():
        monkeypatch.setattr(module, name, size)
    monkeypatch.setattr(driving, "VALIDATION_CASES", Cases("val", 0, cases))
    splits = {split: dataclasses.replace(part, stop=part.start + cases) for split, part in driving.CARD_CASES.items()}
    monkeypatch.setattr(driving, "CARD_CASES", splits)


def start(config):
    """A training that writes no files."""
    return make_training(config, "cpu")


def train(config, directory):
    """A runner that has trained to the end."""
    runner = Runner.start(config, directory, "cpu")
    list(runner.train())
    return runner


def kill(config, directory, points):
    """Stop a training after a number of points of its curve."""
    training = Runner.start(config, directory, "cpu").train()
    for _ in range(points):
        next(training)
    with pytest.raises(Killed):
        training.throw(Killed)


def resume(directory, methods=METHODS):
    """A runner that has resumed a training and trained to the end."""
    runner = Runner.resume(directory, "cpu", methods=methods)
    assert runner.training.progress < 1.0
    list(runner.train())
    return runner


def untimed(training):
    """The curve without times."""
    return [point | {"seconds": 0.0} for point in training.curve]
