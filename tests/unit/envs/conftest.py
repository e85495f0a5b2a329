"""Spaces sample the same actions in every run of the tests, so that a failure can be repeated."""

from types import SimpleNamespace

import pytest
from gymnasium.spaces import space
from gymnasium.utils import seeding


@pytest.fixture(autouse=True)
def same_samples(monkeypatch):
    def np_random(seed=None):
        return seeding.np_random(0 if seed is None else seed)

    monkeypatch.setattr(space, "seeding", SimpleNamespace(np_random=np_random))
