import os
from threading import Event, Thread, get_ident

import numpy as np
import pytest
import torch

from crowdbench import load_planner, load_scenario
from crowdbench.networks.chunks import in_chunks, one_torch_thread
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


def test_work_within_work_is_done_by_the_thread_that_it_is_in(threads):
    threads(2)
    found = []

    def outer(part):
        in_chunks(lambda inner: found.append((part.start, inner.start, get_ident())), 4, 2)

    in_chunks(outer, 4, 2)
    assert sorted((start, inner) for start, inner, _ in found) == [(0, 0), (0, 2), (2, 0), (2, 2)]
    assert len({(start, thread) for start, _, thread in found}) == 2
    assert torch.get_num_threads() == 2


def test_within_one_torch_thread_chunks_are_shared_and_torch_stays_alone(threads):
    threads(2)
    found = set()
    with one_torch_thread() as number:
        assert number == 2
        in_chunks(lambda part: found.add(get_ident()), 64, 1)
        assert get_ident() not in found
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked here")
def test_a_forked_process_has_workers_of_its_own(threads):
    threads(2)
    in_chunks(lambda part: None, 4, 1)
    child = os.fork()
    if child == 0:
        done = []
        in_chunks(lambda part: done.append(part.start), 4, 1)
        os._exit(0 if sorted(done) == [0, 1, 2, 3] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


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
    planner = load_planner("sarl_sgan_kce")
    found = []
    for network in (planner.value.value, planner.predictor.generator.decoder):
        network.register_forward_hook(lambda *_: found.append(torch.get_num_threads()))
    obs = observe(load_scenario("circle_crossing_5").draw("val", np.arange(2)), logs={})
    planner.plan(obs)
    assert set(found) == {1}
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("name", ["sarl_cvm", "sarl_sgan_kce"])
def test_values_have_the_same_bits_with_any_number_of_threads(name, threads):
    planner = load_planner(name)
    obs = observe(load_scenario("circle_crossing_5").draw("val", np.arange(60)))
    obs.pedestrians.observed[:] = 8
    found = []
    for number in (1, 2):
        threads(number)
        found.append(planner.plan(obs))
    assert np.array_equal(*found)
