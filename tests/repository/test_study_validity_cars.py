"""People beside cars in the clips of DUT."""

import numpy as np
import pytest

from crowdbench.utils.errors import InputError
from studies.validity import cars, cars_page, energy
from studies.validity.cars import Windows

RIGHT = np.array([1.0, 0.0])


def windows(moved, clips, group=0):
    """People of one window for each clip, who walk along x; the car is on their left."""
    number = len(moved)
    forward, away = np.tile([1.0, 0.0], (number, 1)), np.tile([0.0, -1.0], (number, 1))
    groups = np.full(number, group)
    return Windows([], np.arange(1 + max(clips)), np.array(clips), np.zeros(number, int), groups, forward, away, moved)


def test_the_same_displacements_are_at_no_distance_and_shifted_ones_by_what_one_computes_by_hand():
    # Of points at 0 and 1: mixed pairs are 1 apart or 0, so that without bias the distance of a copy is 0.
    points = np.repeat([[0.0, 0.0], [1.0, 0.0]], 20, axis=0)
    found = windows(points, list(range(40)))
    assert energy.distance(found, points).mean == pytest.approx(0.0)
    shifted = energy.distance(found, points + RIGHT * 3.0).mean
    within = 2 * 20 * 20 / (40 * 39)
    across = (2 * 20 * 19 * 3.0 + 20 * 20 * (4.0 + 2.0)) / (40 * 39)
    assert shifted == pytest.approx(2 * across - 2 * within)


def test_a_difference_is_paired_by_clip():
    generator = np.random.default_rng(0)
    points = generator.normal(size=(60, 2))
    found = windows(points, [i % 12 for i in range(60)])
    near, far = points + RIGHT * 0.5, points + RIGHT
    gap = energy.difference(found, far, near)
    assert gap.mean == pytest.approx(energy.distance(found, far).mean - energy.distance(found, near).mean)
    assert 0.0 < gap.low < gap.mean < gap.high
    assert energy.difference(found, near, near) == (0.0, 0.0, 0.0)


def test_the_floor_is_about_0_where_clips_are_alike_and_not_where_they_differ():
    generator = np.random.default_rng(1)
    clips = [i % 10 for i in range(200)]
    alike = windows(generator.normal(size=(200, 2)), clips)
    assert energy.floor(alike).low < 0.0 < energy.floor(alike).high
    apart = windows(alike.moved + 3.0 * np.array(clips)[:, None], clips)
    assert energy.floor(apart).mean > 10 * abs(energy.floor(alike).mean)


def test_groups_with_few_people_do_not_count():
    found = windows(np.zeros((energy.LEAST - 1, 2)), list(range(energy.LEAST - 1)))
    assert energy.distance(found, found.moved + 9.0).mean == 0.0


@pytest.mark.parametrize(
    ("to_car", "closing", "reach", "seconds"),
    [
        ([4.0, 0.0], [-1.0, 0.0], 1.0, 3.0),
        ([4.0, 0.0], [1.0, 0.0], 1.0, np.inf),
        ([4.0, 1.5], [-1.0, 0.0], 1.0, np.inf),
        ([0.5, 0.0], [0.0, 0.0], 1.0, 0.0),
        ([4.0, 0.0], [0.0, 0.0], 1.0, np.inf),
    ],
)
def test_a_car_is_in_the_way_when_it_will_touch(to_car, closing, reach, seconds):
    found = cars._contact(np.array([to_car]), np.array([closing]), np.array([reach]))
    assert found == pytest.approx(seconds)


def test_groups_are_by_gap_and_time():
    names = cars.group_names()
    assert names[cars._group(-0.5, 0.0)] == "0 to 2 m, in 0 to 2 s"
    assert names[cars._group(3.0, 2.5)] == "2 to 4 m, in 2 to 4 s"
    assert names[cars._group(7.9, np.inf)] == "4 to 8 m, none in 4 s"
    assert cars._group(8.0, 1.0) is None


def test_people_walk_beside_the_recorded_cars(shared):
    data = shared / "data" / "dut"
    first, second = cars.cut_halves(data)
    for clip in np.unique(first.clip):
        early, late = (
            [w.first for w, own in zip(each.excerpts, each.clip, strict=True) if own == clip]
            for each in (first, second)
        )
        assert not late or max(early) + cars.SECONDS <= min(late) + 1e-6
    few = second.excerpts[:4]
    own = second.window < len(few)
    part = Windows(few, second.clip[:4], *(getattr(second, name)[own] for name in PEOPLE))
    moved = cars.move(part, "orca", {}, data)
    # They arrive where they were recorded to within a step, and stop for nobody.
    assert np.median(np.hypot(*(moved - part.moved).T)) < 0.5
    slow = cars.move(part, "social_force", {"repulsion_strength": 8.0}, data)
    assert slow[:, 0].mean() < moved[:, 0].mean() - 0.5
    assert "| floor: recorded people of other clips |" in cars_page.section(
        cars_page.BesideCars(part, {"orca": moved}, {})
    )


PEOPLE = ("window", "person", "group", "forward", "away", "moved")


def test_a_folder_without_clips_gets_one_sentence(tmp_path):
    with pytest.raises(InputError, match="which the scene dut needs"):
        cars.cut_halves(tmp_path)
