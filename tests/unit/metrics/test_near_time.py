"""Recompute the bound on the time to collision of near misses from encounters of people in ETH/UCY."""

import numpy as np
import pytest

from crowdbench.metrics.encounters import NEAR_TIME

SCENES = ("biwi_eth", "biwi_hotel", "crowds_zara01", "crowds_zara02", "students001", "students003")
DT, REACH, SOCIAL = 0.4, 0.6, 3.6


def encounters(table):
    """The least time to collision, the smallest gap and the share of slow steps of each encounter of two people."""
    frames = np.unique(table[:, 0])
    step = np.median(np.diff(frames))
    at = {frame: {} for frame in frames}
    for frame, person, *position in table:
        at[frame][person] = position
    met, ended = {}, []
    for frame in frames[np.isin(frames + step, frames)]:
        people = sorted(at[frame].keys() & at[frame + step].keys())
        here, there = (np.array([at[f][p] for p in people]).reshape(-1, 2) for f in (frame, frame + step))
        offset, velocity = here[None] - here[:, None], ((there - here)[None] - (there - here)[:, None]) / DT
        a, b, c = (velocity**2).sum(2), (offset * velocity).sum(2), (offset**2).sum(2) - REACH**2
        meets = (b < 0) & (b * b >= a * c)
        root = np.sqrt(np.where(meets, b * b - a * c, 0.0))
        time = np.where(meets, np.maximum(c / np.where(meets, root - b, 1.0), 0.0), np.inf)
        gap = np.sqrt((offset**2).sum(2)) - REACH
        for i, j in zip(*np.nonzero(np.triu(gap < SOCIAL, 1)), strict=True):
            pair = people[i], people[j]
            if pair in met and met[pair][0] != frame - step:
                ended.append(met.pop(pair))
            _, least, nearest, slow, steps = met.get(pair, (0, np.inf, np.inf, 0, 0))
            met[pair] = (frame, min(least, time[i, j]), min(nearest, gap[i, j]), slow + (a[i, j] < 0.25), steps + 1)
    _, least, nearest, slow, steps = np.array([*ended, *met.values()]).T
    return least, nearest, slow / steps


@pytest.mark.slow
def test_two_in_a_hundred_encounters_of_people_have_a_shorter_time_to_collision(shared):
    scenes = [encounters(np.loadtxt(shared / "data" / "eth_ucy" / f"{scene}.txt")) for scene in SCENES]
    least, nearest, slow = np.concatenate(scenes, axis=1)
    least = least[(nearest >= 0.0) & (slow < 0.5)]
    assert len(least) == 14766
    assert round(100 * (least < NEAR_TIME).mean()) == 2
