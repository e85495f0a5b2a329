import numpy as np

from crowdbench.core import rng


def test_philox_is_numpys():
    counter, key = np.array([5, 6, 7, 8], np.uint64), np.array([123456789, 2**63 + 11], np.uint64)
    # NumPy raises the counter before it draws.
    expected = np.random.Philox(counter=counter - np.eye(4, dtype=np.uint64)[0], key=key).random_raw(4)
    assert list(rng.philox(*counter, *key)) == list(expected)


def test_noise_is_standard_normal():
    keys = rng.case_keys(0, "train", np.arange(2000))
    noise = rng.normal(keys, "test", np.zeros(2000, np.int64), (5, 7)).ravel()
    assert abs(noise.mean()) < 0.02
    assert abs(noise.std() - 1) < 0.01
    assert abs((noise**3).mean()) < 0.05
    assert abs((noise**4).mean() - 3) < 0.1


def test_noise_depends_on_case_step_pedestrian_and_purpose_alone():
    keys, steps = rng.case_keys(3, "val", np.arange(10)), np.arange(10)
    noise = rng.normal(keys, "a", steps, (4, 6))
    assert np.array_equal(noise[7:8, :2, :3], rng.normal(keys[7:8], "a", steps[7:8], (2, 3)))
    for other in (
        rng.normal(keys, "b", steps, (4, 6)),
        rng.normal(keys, "a", steps + 1, (4, 6)),
        rng.normal(rng.case_keys(4, "val", np.arange(10)), "a", steps, (4, 6)),
    ):
        assert not (noise == other).any()
    assert len(np.unique(noise)) == noise.size


def test_cases_splits_and_seeds_have_different_keys():
    keys = [rng.case_keys(seed, split, np.arange(1000)) for seed in (0, 1) for split in rng.SPLITS]
    assert len(np.unique(np.concatenate(keys))) == 6000
