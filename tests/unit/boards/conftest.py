"""The entry that tests of boards change."""

import pytest


@pytest.fixture
def folder(root):
    """The folder of an entry in a folder of boards, which a test may change."""
    return root / "small" / "entries" / "careful"
