import numpy as np
import pytest
import torch

from crowdbench import load_planner, load_scenario
from crowdbench.planners.lookahead.chunks import in_chunks
from crowdbench.sim.sensor import observe


@pytest.fixture
def threads():
    """What sets the number of torch's threads, which comes back afterwards."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize(("rows", "chunk"), [(0, 3), (1, 3), (3, 3), (10, 3)])
def test_every_row_is_worked_on_once(number, rows, chunk, threads):
    threads(number)
    seen = np.zeros(rows, int)

    def work(part):
        assert torch.get_num_threads() == 1
        seen[part] += 1

    in_chunks(work, rows, chunk)
    assert (seen == 1).all()
    assert torch.get_num_threads() == number


@pytest.mark.parametrize("number", [1, 2])
def test_what_work_raises_is_raised_and_leaves_the_threads_as_they_were(number, threads):
    threads(number)

    def work(part):
        raise ValueError(part.start)

    with pytest.raises(ValueError, match="0"):
        in_chunks(work, 10, 3)
    assert torch.get_num_threads() == number


@pytest.mark.parametrize("name", ["sarl_cvm", "sarl_sgan_kce"])
def test_values_have_the_same_bits_with_any_number_of_threads(name, threads):
    _, planner = load_planner(name)
    obs = observe(load_scenario("circle_crossing_5").draw("val", np.arange(60)))
    obs.pedestrians.observed[:] = 8
    found = []
    for number in (1, 2):
        threads(number)
        found.append(planner.plan(obs))
    assert np.array_equal(*found)
