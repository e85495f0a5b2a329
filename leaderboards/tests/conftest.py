"""Fixtures of the tests of boards."""

import shutil

import pytest
from small_boards import verified_root

from tests.conftest import call, one_thread, reference, shared  # noqa: F401, fixtures


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A folder with `leaderboards`, whose two entries were verified in a season, and its maintainer's key."""
    return verified_root(tmp_path_factory)


@pytest.fixture
def root(made, tmp_path):
    """A copy of these leaderboards, which a test may change."""
    shutil.copytree(made / "leaderboards", tmp_path / "leaderboards")
    return tmp_path / "leaderboards"


@pytest.fixture
def folder(root):
    """The folder of an entry in a folder of boards, which a test may change."""
    return root / "small" / "entries" / "careful"
