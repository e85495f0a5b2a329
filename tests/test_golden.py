"""The shipped learned planners still do what they did when their weights were recorded."""

import json

import numpy as np
import pytest
import torch
from golden.record import FOLDER, PLANNERS, outcomes, values

TIE = 1e-5
"""Values that differ by less are a tie, which may fall either way: networks round by the shape of their batch."""


@pytest.fixture(params=[1, 2])
def threads(request):
    """So many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", PLANNERS)
def test_golden_cases_end_as_recorded(name, threads):
    golden = json.loads((FOLDER / f"{name}.json").read_text())
    assert outcomes(name) == golden["outcomes"]


@pytest.mark.parametrize("name", PLANNERS)
def test_recorded_commands_are_still_the_best(name, threads):
    golden = json.loads((FOLDER / f"{name}.json").read_text())
    found = values(name)
    assert len(golden["chosen"]) == len(found) > 25
    chosen = found[np.arange(len(found)), golden["chosen"]]
    assert (found.max(axis=1) - chosen).max() < TIE
    assert (found.max(axis=1) - found.min(axis=1)).min() > 100 * TIE
