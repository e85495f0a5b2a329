import itertools

import numpy as np
import pytest
import torch
from test_predict import bent, observation

from crowdbench import InputError
from crowdbench.core.types import HISTORY
from crowdbench.networks.social_gan import SGAN_HIDDEN, SGAN_NOISE, Generator
from crowdbench.predict.social_gan import SocialGAN, extrapolated_history

BOTH = pytest.mark.parametrize("pooling", [False, True])


def generator(pooling=False):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Generator(pooling).eval()


def predictor(pooling=False, **options):
    return SocialGAN(generator(pooling), {"dt": 0.4, "scenes": ["eth"]}, **options)


def crowds(worlds, pedestrians, present=None):
    """An observation in which every world is a case of its own."""
    obs = observation(bent(worlds, pedestrians))
    obs.noise_key[:] = np.arange(worlds)
    if present is not None:
        obs.pedestrians.seen[:] = present
    return obs


def slowly(network, history, noise, steps):
    """The displacements of one scene's futures, one pedestrian after the other: [mode, pedestrian, steps, 2]."""
    moves = history.diff(dim=0)
    hidden = []
    for p in range(history.shape[1]):
        state = (torch.zeros(1, 1, SGAN_HIDDEN), torch.zeros(1, 1, SGAN_HIDDEN))
        for move in moves[:, p]:
            _, state = network.encoder.lstm(torch.relu(network.encoder.embed(move))[None, None], state)
        hidden.append(state[0][0, 0])
    out = torch.zeros(len(noise), history.shape[1], steps, 2)
    for (m, z), p in itertools.product(enumerate(noise), range(history.shape[1])):
        sees = hidden[p]
        if network.pooling is not None:
            pool = network.pooling
            each = [
                torch.relu(pool.mlp(torch.cat([pool.place(history[-1, q] - history[-1, p]), hidden[q]])))
                for q in range(history.shape[1])
            ]
            sees = torch.cat([sees, torch.stack(each).amax(dim=0)])
        state, cell, move = torch.cat([network.context(sees), z])[None], torch.zeros(1, SGAN_HIDDEN), moves[-1, p][None]
        for t in range(steps):
            state, cell = network.decoder(torch.relu(network.embed(move)), (state, cell))
            move = move + network.move(state)
            out[m, p, t] = move[0]
    return out


@BOTH
@torch.inference_mode()
def test_a_batch_of_scenes_is_each_scene_by_itself_without_whoever_is_absent(pooling):
    network, rng = generator(pooling), torch.Generator().manual_seed(1)
    history = torch.randn((3, HISTORY, 4, 2), generator=rng).cumsum(dim=1)
    present = torch.tensor([[True, True, True, True], [False, True, False, True], [True, False, False, False]])
    noise = torch.randn((3, 5, SGAN_NOISE), generator=rng)
    moves = network(history, present, noise, 6)
    assert moves.shape == (5, 7, 6, 2)
    for scene, rows in enumerate([slice(0, 4), slice(4, 6), slice(6, 7)]):
        alone = slowly(network, history[scene][:, present[scene]], noise[scene], 6)
        torch.testing.assert_close(moves[:, rows], alone, rtol=1e-4, atol=1e-5)


@BOTH
def test_a_case_is_predicted_alike_alone_and_in_a_batch(pooling):
    obs = crowds(6, 3)
    together, alone = predictor(pooling).predict(obs, 4), predictor(pooling).predict(obs.take(np.array([4])), 4)
    assert together.position.shape == (6, 20, 4, 3, 2)
    np.testing.assert_allclose(alone.position[0], together.position[4], atol=1e-5)
    assert np.abs(together.position[3] - together.position[4]).max() > 0.1


@BOTH
def test_the_order_of_pedestrians_does_not_matter(pooling):
    obs, order = crowds(4, 3), [2, 0, 1]
    turned = crowds(4, 3)
    for name in ("position", "history"):
        getattr(turned.pedestrians, name)[:] = getattr(obs.pedestrians, name)[..., order, :]
    one, other = predictor(pooling).predict(obs, 4), predictor(pooling).predict(turned, 4)
    np.testing.assert_allclose(one.position[:, :, :, order], other.position, atol=1e-5)


def test_fewer_modes_are_the_first_of_more_and_steps_differ():
    obs = crowds(3, 2)
    few, many = (predictor(modes=modes).predict(obs, 4).position for modes in (5, 20))
    np.testing.assert_allclose(few, many[:, :5], atol=1e-6)
    obs.step[:] += 1
    assert np.abs(predictor(modes=5).predict(obs, 4).position - few).max() > 1e-3


@pytest.mark.parametrize("absent", [0, 1])
@pytest.mark.parametrize("pooling", [False, True])
def test_whoever_is_absent_changes_nothing_and_is_given_finite_numbers(pooling, absent):
    others = np.arange(3) != absent
    obs = crowds(2, 3, present=[others, [True, True, True]])
    found = predictor(pooling).predict(obs, 3).position
    obs.pedestrians.history[0, :, absent] = np.nan
    again = predictor(pooling).predict(obs, 3).position
    np.testing.assert_allclose(again[0][:, :, others], found[0][:, :, others])
    assert np.isfinite(found).all()


@BOTH
@pytest.mark.parametrize("pedestrians", [0, 1])
def test_few_or_nobody(pooling, pedestrians):
    found = predictor(pooling).predict(crowds(2, pedestrians), 3)
    assert found.position.shape == (2, 20, 3, pedestrians, 2)
    nobody = crowds(2, 2, present=False)
    found = predictor(pooling).predict(nobody, 3)
    assert np.array_equal(found.velocity, np.zeros((2, 20, 3, 2, 2)))


def test_history_is_extrapolated_backwards_from_the_first_displacement():
    tracks, observed = bent(), np.arange(1, HISTORY + 1)
    history = extrapolated_history(observation(tracks, observed).pedestrians)
    for w, seen in enumerate(observed):
        first = HISTORY - seen
        assert np.array_equal(history[w, first:], tracks[w, first:])
        move = tracks[w, first + 1] - tracks[w, first] if seen > 1 else np.zeros((3, 2))
        for t in range(first):
            np.testing.assert_allclose(history[w, t], tracks[w, first] - (first - t) * move)


def test_rescaled_steps_are_the_same_walk_seen_by_a_slower_clock():
    obs = crowds(2, 2)
    stretched = observation(bent(2, 2) * 1.6)
    stretched.noise_key[:] = obs.noise_key
    as_it_is, rescaled = predictor().predict(stretched, 4), predictor(rescaled=True).predict(obs, 4)
    np.testing.assert_allclose(rescaled.position * 1.6, as_it_is.position, atol=1e-4)


def test_it_is_scored_only_where_it_was_not_trained():
    made = predictor(modes=5)
    assert made.for_held_out_scene("hotel") is made
    other = made.for_held_out_scene("eth")
    assert other.modes == 5
    assert "eth" not in other.about["scenes"]
    with pytest.raises(InputError, match="were trained on eth, and so cannot be scored there"):
        predictor(weights="mine").for_held_out_scene("eth")
