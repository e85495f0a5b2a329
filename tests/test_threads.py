from threading import Event, Thread

import numpy as np
import pytest
import torch

from crowdbench import load_planner, load_scenario
from crowdbench.sim.sensor import observe
from crowdbench.utils.threads import in_chunks


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


def test_work_that_overlaps_in_several_threads_leaves_torch_as_it_was(threads):
    threads(2)
    inside, outside, found = Event(), Event(), []

    def long(part):
        inside.set()
        assert outside.wait(10)

    def run(work):
        in_chunks(work, 1, 1)
        found.append(torch.get_num_threads())

    first = Thread(target=run, args=[long])
    first.start()
    assert inside.wait(10)
    second = Thread(target=run, args=[lambda part: None])
    second.start()
    second.join()
    outside.set()
    first.join()
    later = Thread(target=run, args=[lambda part: None])
    later.start()
    later.join()
    assert found == [2, 2, 2]


def test_every_network_of_a_decision_runs_in_one_of_torchs_threads(threads):
    threads(2)
    _, planner = load_planner("sarl_sgan_kce")
    found = []
    for network in (planner.value.value, planner.predictor.generator.decoder):
        network.register_forward_hook(lambda *_: found.append(torch.get_num_threads()))
    obs = observe(load_scenario("circle_crossing_5").draw("val", np.arange(2)), logs={})
    planner.plan(obs)
    assert set(found) == {1}
    assert torch.get_num_threads() == 2


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
