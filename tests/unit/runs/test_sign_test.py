"""The test of two rates over cases that come in blocks."""

import numpy as np
import pytest

from crowdbench.results.paired import EXACT, sign_test


def test_a_difference_in_one_block_proves_nothing_however_many_cases_it_has():
    block = np.repeat(np.arange(10), 30)
    assert sign_test(block < 5, block < 6, block) == 1.0


def test_without_a_difference_p_is_one():
    solved = np.arange(20) % 3 == 0
    assert sign_test(solved, solved, np.arange(20) // 4) == 1.0


@pytest.mark.parametrize("blocks", [4, 8, EXACT])
def test_it_is_exact_where_one_run_is_better_in_all_blocks(blocks):
    block = np.repeat(np.arange(blocks), 3)
    never, always = np.zeros(len(block), bool), np.ones(len(block), bool)
    assert sign_test(never, always, block) == sign_test(always, never, block) == 2.0 * 0.5**blocks


def test_it_finds_as_many_differences_by_chance_as_it_says():
    rng, found = np.random.default_rng(5), []
    block = np.repeat(np.arange(30), 4)
    for _ in range(200):
        # What a block is like counts more for a planner than the case.
        one, two = (rng.uniform(size=120) < rng.uniform(size=30)[block] for _ in range(2))
        found.append(sign_test(one, two, block) < 0.05)
    assert np.mean(found) < 0.1
