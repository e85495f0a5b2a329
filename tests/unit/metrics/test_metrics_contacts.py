"""Whose part in a contact was how large, on traces whose figures are computed by hand, and by symmetry."""

import dataclasses

import numpy as np
import pytest
from helpers import drive, trace

from crowdbench.core.types import Outcome, Rules
from crowdbench.metrics.fault import Fault, find_contacts
from crowdbench.metrics.registry import METRICS

FAR = [50.0, 50.0]

RATES = {
    Fault.STRUCK_STANDING: "struck_standing_rate",
    Fault.STRUCK_BEHIND: "struck_behind_rate",
    Fault.STRUCK: "struck_otherwise_rate",
    Fault.ALONE: "hit_alone_rate",
    Fault.BOTH: "hit_both_rate",
}


def walk(start, *velocities, steps=6, dt=0.25):
    """Positions `[time, 2]` of who walks with one velocity after the other, each for as many steps."""
    motion = np.repeat(np.array(velocities, float), steps // len(velocities), axis=0)
    return np.concatenate([[start], np.array(start) + dt * motion.cumsum(axis=0)])


def collided(vehicle, *pedestrians, facing=0.0, outcome=Outcome.COLLISION, **options):
    """An episode that ends with a collision; nobody is in the way of anybody else but at its end."""
    episode = trace(np.stack([vehicle, *pedestrians], axis=1), outcome, **options)
    return dataclasses.replace(episode, heading=np.full(episode.heading.shape, facing))


def found(episode):
    contacts = find_contacts(episode)
    return Fault(contacts.fault[0]), contacts.share[0]


def ends_at(ways, gap=0.5):
    """Ways that are moved so that the second begins where its end touches that of the first, from before it."""
    vehicle, pedestrian = ways
    return vehicle, pedestrian + (vehicle[-1] + [gap, 0.0] - pedestrian[-1])


@pytest.mark.parametrize(
    ("vehicle", "pedestrian", "facing", "fault", "share"),
    [
        ([0, 0], [-1, 0], 0.0, Fault.STRUCK_STANDING, 0.0),
        ([1, 0], [0, 0], 0.0, Fault.ALONE, 1.0),
        ([1, 0], [-1, 0], 0.0, Fault.BOTH, 0.5),
        ([0.5, 0], [-1.0, 0], 0.0, Fault.BOTH, 1 / 3),
        ([1, 0], [0.4, 0], 0.0, Fault.ALONE, 1.0),
        ([-0.4, 0], [-1, 0], np.pi, Fault.STRUCK_BEHIND, 0.0),
        ([-0.4, 0], [-1, 0], np.radians(115), Fault.STRUCK, 0.0),
        ([0.05, 0], [-1, 0], 0.0, Fault.STRUCK_STANDING, 1 / 21),
        ([0.0, 0.1], [0.0, 0.1], 0.0, Fault.UNDETERMINED, np.nan),
    ],
)
def test_the_share_is_that_of_the_approach(vehicle, pedestrian, facing, fault, share):
    if fault == Fault.STRUCK_STANDING and share:
        vehicle = [0.0499, 0]
    episode = collided(*ends_at((walk([0, 0], vehicle), walk([0, 0], pedestrian))), facing=facing)
    answer, phi = found(episode)
    assert answer == fault
    assert phi == pytest.approx(share, abs=2e-3, nan_ok=True)
    assert {name: bool(METRICS[name](episode)[0]) for name in RATES.values()} == {
        name: each == fault for each, name in RATES.items()
    }
    assert METRICS["at_fault_rate"](episode)[0] == (share >= 0.1)


def test_only_the_last_second_counts_and_braking_at_its_end_changes_little():
    # It drives at 1 m/s, and stands for the last quarter of a second: three quarters against one of him who comes.
    brakes = walk([0, 0], *[[1, 0]] * 7, [0, 0], steps=8)
    episode = collided(*ends_at((brakes, walk([0, 0], [-1, 0], steps=8)), gap=0.6))
    assert found(episode) == (Fault.BOTH, pytest.approx(0.75 / 1.75, abs=0.01))
    # What was before the window does not count.
    waits = walk([0, 0], *[[1, 0]] * 2, *[[0, 0]] * 6, steps=8)
    assert found(collided(*ends_at((waits, walk([0, 0], [-1, 0], steps=8)))))[0] == Fault.STRUCK_STANDING


def test_impact_speed_is_the_relative_speed_of_those_who_touch():
    meet = ends_at((walk([0, 0], [1, 0]), walk([0, 0], [-0.5, 0])))
    episode = collided(*meet, walk([9, 9], [-1, -1]))
    assert METRICS["impact_speed"](episode)[0] == pytest.approx(1.5)
    assert find_contacts(episode).agent[0] == 1
    nobody = find_contacts(dataclasses.replace(episode, outcome=np.array([Outcome.TIMEOUT])))
    assert (nobody.fault[0], nobody.agent[0]) == (Fault.NONE, 0)
    assert np.isnan([nobody.speed[0], nobody.share[0]]).all()


def test_of_contacts_at_the_same_time_the_largest_share_counts():
    vehicle, ahead = ends_at((walk([0, 0], [1, 0]), walk([0, 0], [0, 0])))
    comes = vehicle * [1, -1] + [0, 0.5] - walk([0, 0], [0, 1])[::-1] * [0, -1]
    for others in ((ahead, comes), (comes, ahead)):
        episode = collided(vehicle, *others)
        assert find_contacts(episode).agent[0] == 1 + (others[1] is ahead)
        assert found(episode)[0] == Fault.ALONE


def test_who_drives_into_a_wall_is_at_fault():
    episode = collided(walk([0, 0], [1, 0]), walk(FAR, [0, 0]), outcome=Outcome.WALL_COLLISION)
    assert found(episode) == (Fault.ALONE, 1.0)
    assert all(METRICS[name](episode)[0] for name in ("at_fault_rate", "hit_alone_rate"))
    assert np.isnan(METRICS["impact_speed"](episode)[0])


def test_a_long_body_is_touched_where_it_is_and_its_turning_counts():
    # The front disc is 1 m ahead: who comes from the side touches it and not the rear one.
    side = collided(walk([0, 0], [1, 0], steps=4), walk([2.0, 1.4], [0, -1], steps=4))
    side = dataclasses.replace(side, rules=Rules(body=(0.0, 0.5, 1.0)))
    assert METRICS["impact_speed"](side)[0] == pytest.approx(np.sqrt(2))
    # Its axle stands, and its front swings into somebody who stands.
    turns = collided(walk([0, 0], [0, 0], steps=4), walk([0.9, 0.9], [0, 0], steps=4))
    heading = np.zeros_like(turns.heading)
    heading[0, :5] = np.linspace(0.0, np.pi / 6, 5)
    turns = dataclasses.replace(turns, rules=Rules(body=(0.0, 1.0)), heading=heading)
    contacts = find_contacts(turns)
    assert contacts.share[0] == pytest.approx(1.0)


def random_contacts(seed, number=40, steps=8):
    """Episodes that end with two discs touching, whose ways are random and smooth."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        velocity = rng.normal(0, 0.8, (2, 1, 2)) + rng.normal(0, 0.2, (2, steps, 2))
        ways = np.concatenate([np.zeros((2, 1, 2)), 0.25 * velocity.cumsum(axis=1)], axis=1)
        angle = rng.uniform(0, 2 * np.pi)
        touch = rng.uniform(0.3, 0.59) * np.array([np.cos(angle), np.sin(angle)])
        ways[1] += ways[0, -1] + touch - ways[1, -1]
        yield collided(*ways, facing=rng.uniform(-np.pi, np.pi))


def changed(episode, turn, heading):
    return dataclasses.replace(episode, position=turn(episode.position), heading=heading(episode.heading))


@pytest.mark.parametrize("seed", range(3))
def test_who_is_swapped_has_the_other_share_and_mirrors_and_turns_change_nothing(seed):
    c, s = np.cos(0.7), np.sin(0.7)
    for episode in random_contacts(seed):
        fault, share = found(episode)
        turned = changed(episode, lambda p: p @ np.array([[c, s], [-s, c]]), lambda h: h + 0.7)
        mirrored = changed(episode, lambda p: p * [1, -1], lambda h: -h)
        for other in (turned, mirrored):
            assert found(other) == (fault, pytest.approx(share, abs=1e-9, nan_ok=True))
        swapped = changed(episode, lambda p: p[:, :, ::-1], lambda h: h)
        assert found(swapped)[1] == pytest.approx(1.0 - share, abs=1e-9, nan_ok=True)
        assert fault != Fault.NONE


@pytest.mark.slow
def test_many_episodes_have_the_shares_that_each_has_alone():
    batch = drive("straight", "test:60", "circle_20_blind")
    whole = find_contacts(batch)
    assert set(whole.fault.tolist()) > {Fault.BOTH}
    for row in (0, 17, 42):
        alone = find_contacts(drive("straight", f"test:{row}:{row + 1}", "circle_20_blind"))
        for name, values in alone._asdict().items():
            np.testing.assert_array_equal(getattr(whole, name)[[row]], values)


@pytest.mark.slow
def test_the_trace_and_its_recording_say_who_had_noticed_the_vehicle(tmp_path):
    some = drive("straight", "test:40", "groups_12")
    assert some.noticed is not None
    saw = find_contacts(some).saw
    seen = METRICS["at_fault_seen_rate"](some)
    assert seen.any()
    assert (METRICS["at_fault_rate"](some) & ~seen).any()
    assert (saw | ~seen).all()
    for scenario, visible in (("circle_crossing_5", False), ("circle_crossing_5_visible", True)):
        alike = drive("straight", "test:30", scenario)
        assert alike.noticed is None
        assert (find_contacts(alike).saw == (visible & (alike.outcome == Outcome.COLLISION))).all()
