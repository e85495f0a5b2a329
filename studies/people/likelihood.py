"""The score: log-likelihoods of the recording among the rollouts of a model. See definition.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from studies.people.features import BINS, CONTACT, Places, bins_of, blocks, closest_approach, per_frame
from studies.people.windows import Window

UNIFORM = 0.05
"""Share of the uniform distribution in every probability."""

THIRDS: Mapping[str, tuple[str, ...]] = {
    "motion": ("speed", "acceleration", "turning"),
    "path": ("along", "lateral"),
    "encounter": ("closest", "contact"),
}
"""The features of each third of the score."""


@dataclass(frozen=True)
class WindowScore:
    """The score of a model in a window.

    Attributes:
        log: Mean log-likelihood of each third over persons; NaN if no person has it.
        contacts: Mean number of scored persons with a new contact in a rollout.
        recorded: Number of scored persons with a new contact in the recording.
        persons: Number of scored persons.
    """

    log: Mapping[str, float]
    contacts: float
    recorded: int
    persons: int


def score_window(window: Window, places: Places) -> WindowScore:
    """Return the score of rollouts in a window.

    Args:
        window: The window.
        places: Positions in its rollouts in metres.
    """
    persons, truth = window.scored, window.future[None]
    simulated, recorded = per_frame(window, places), per_frame(window, truth)
    logs = {
        name: log_frames(
            bins_of(name, simulated[name][..., persons]), bins_of(name, recorded[name][0][..., persons])
        )
        for name in simulated
    }
    # Frames after a person has left do not count.
    here = window.present[1:, persons]
    of_person = {name: np.where(here, log, 0.0).sum(axis=0) / here.sum(axis=0) for name, log in logs.items()}
    near, nearest = closest_approach(window, places, persons), closest_approach(window, truth, persons)[0]
    conflict = window.conflict[persons]
    bins = bins_of("closest", near)[:, None], bins_of("closest", nearest)[None]
    touches, touched = near < CONTACT, nearest < CONTACT
    share = (1.0 - UNIFORM) * touches.mean(axis=0) + UNIFORM / 2.0
    of_person["closest"] = np.where(conflict, _log_block(*bins)[0], np.nan)
    of_person["contact"] = np.where(conflict, np.log(np.where(touched, share, 1.0 - share)), np.nan)
    thirds = {third: np.mean([of_person[name] for name in names], axis=0) for third, names in THIRDS.items()}
    return WindowScore(
        {third: float(np.nanmean(log)) if np.isfinite(log).any() else np.nan for third, log in thirds.items()},
        float(touches.mean(axis=0).sum()),
        int(touched.sum()),
        int(persons.sum()),
    )


def score(windows: Sequence[Window], rollouts: Sequence[Places]) -> list[WindowScore]:
    """Return the score of rollouts in each window."""
    return [score_window(window, places) for window, places in zip(windows, rollouts, strict=True)]


def log_frames(
    simulated: Int[np.ndarray, "rollout frame person"], recorded: Int[np.ndarray, "frame person"]
) -> Float[np.ndarray, "frame person"]:
    """Return the log-likelihood of the recorded bin of each frame in the histogram of its block."""
    block = blocks()
    parts = [_log_block(simulated[:, block == b], recorded[block == b]) for b in np.unique(block)]
    return np.concatenate(parts)


def _log_block(
    simulated: Int[np.ndarray, "rollout frame person"], recorded: Int[np.ndarray, "frame person"]
) -> Float[np.ndarray, "frame person"]:
    """Return log-likelihoods in one histogram of all rollouts and frames for each person."""
    samples = simulated.reshape(-1, simulated.shape[-1])
    counts = (samples[..., None] == np.arange(BINS + 1)).sum(axis=0)
    share = smooth(counts / len(samples))
    return np.log(share[np.arange(len(share)), recorded])


def smooth(share: Float[np.ndarray, "person bin"]) -> Float[np.ndarray, "person bin"]:
    """Return histograms after the kernel 1/4 1/2 1/4, mixed with a uniform distribution.

    At both ends the kernel's outer part stays in the bin. The last bin, of undefined values, is not smoothed.
    """
    inner = share[:, :BINS]
    padded = np.concatenate([inner[:, :1], inner, inner[:, -1:]], axis=1)
    kernel = padded[:, :-2] / 4.0 + inner / 2.0 + padded[:, 2:] / 4.0
    mixed = np.concatenate([kernel, share[:, BINS:]], axis=1)
    return (1.0 - UNIFORM) * mixed + UNIFORM / (BINS + 1)
