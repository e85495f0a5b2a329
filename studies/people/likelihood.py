"""The score: log-likelihoods of the recording among the rollouts of a model. See definition.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from studies.people.encounters import Places, closest_approach
from studies.people.features import BINS, CONTACT, bins_of, per_frame
from studies.people.windows import BLOCK, Window

PerPerson = Float[np.ndarray, "person"]
PerRollout = Float[np.ndarray, "rollout person"]

UNIFORM = 0.05
"""Share of the uniform distribution in every probability."""

BIN_NUMBERS = np.arange(BINS + 1)

THIRDS: Mapping[str, tuple[str, ...]] = {
    "motion": ("speed", "acceleration", "turning"),
    "path": ("along", "lateral"),
    "encounter": ("closest", "contact"),
}
"""The features of each third of the score."""


FARTHEST = 4.0
"""Distance in metres by which a closest approach is bounded in the mean closest approach."""


@dataclass(frozen=True)
class WindowScore:
    """The score of a model in a window.

    Attributes:
        log: Mean log-likelihood of each third over persons; NaN if no person has it.
        persons: Number of scored persons.
        contacts: Mean number of scored persons with a new contact in a rollout.
        recorded_contacts: Number of scored persons with a new contact in the recording.
        conflicts: Number of persons in conflict.
        closest: Sum of their mean closest approaches in metres, at most `FARTHEST` each.
        recorded_closest: The same in the recording.
    """

    log: Mapping[str, float]
    persons: int
    contacts: float
    recorded_contacts: int
    conflicts: int
    closest: float
    recorded_closest: float


def score_window(window: Window, places: Places) -> WindowScore:
    """Return the score of rollouts in a window.

    Args:
        window: The window.
        places: Positions in its rollouts in metres.
    """
    persons, truth = window.scored, window.future[None]
    near = closest_approach(places, window.strangers, persons)
    nearest = closest_approach(truth, window.strangers, persons)[0]
    of_person = log_motion(window, places, persons) | {
        "closest": log_value("closest", near, nearest),
        "contact": log_event(near < CONTACT, nearest < CONTACT),
    }
    return make_score(of_person, THIRDS, window.conflict[persons], (near, nearest), limit=CONTACT)


def make_score(
    of_person: Mapping[str, PerPerson],
    thirds: Mapping[str, tuple[str, ...]],
    conflict: Bool[np.ndarray, "person"],
    closest: tuple[PerRollout, PerPerson],
    limit: float,
) -> WindowScore:
    """Return the score of a window from the log-likelihoods of its persons.

    Args:
        of_person: Log-likelihoods by feature.
        thirds: The features of each third.
        conflict: The persons that have an encounter.
        closest: Closest approaches in metres in the rollouts and in the recording.
        limit: Distance in metres of a contact.
    """
    logs = {third: np.mean([of_person[name] for name in names], axis=0) for third, names in thirds.items()}
    logs["encounter"] = logs["encounter"][conflict]
    simulated, recorded = closest
    near, nearest = (np.minimum(values[..., conflict], FARTHEST) for values in closest)
    return WindowScore(
        log={third: float(log.mean()) if len(log) else np.nan for third, log in logs.items()},
        persons=len(conflict),
        contacts=float((simulated < limit).mean(axis=0).sum()),
        recorded_contacts=int((recorded < limit).sum()),
        conflicts=int(conflict.sum()),
        closest=float(near.mean(axis=0).sum()),
        recorded_closest=float(nearest.sum()),
    )


def score(windows: Sequence[Window], rollouts: Sequence[Places]) -> list[WindowScore]:
    """Return the score of rollouts in each window."""
    return [score_window(window, places) for window, places in zip(windows, rollouts, strict=True)]


def log_motion(window: Window, places: Places, persons: Bool[np.ndarray, "all"]) -> dict[str, PerPerson]:
    """Return each person's mean log-likelihood of each feature of motion and path.

    Args:
        window: The window.
        places: Positions in its rollouts in metres.
        persons: The persons to return.
    """
    simulated, recorded = per_frame(window, places), per_frame(window, window.future[None])
    here = window.present[1:, persons]
    return {
        name: log_frames(
            bins_of(name, simulated[name][..., persons]), bins_of(name, recorded[name][0][..., persons]), here
        )
        for name in simulated
    }


def log_frames(
    simulated: Int[np.ndarray, "rollout frame person"],
    recorded: Int[np.ndarray, "frame person"],
    here: Bool[np.ndarray, "frame person"],
) -> Float[np.ndarray, "person"]:
    """Return each person's mean log-likelihood of the recorded bins, in the histograms of their blocks.

    Args:
        simulated: The bin in each rollout.
        recorded: The recorded bin.
        here: True in the frames that count.
    """
    total = np.zeros(here.shape[1])
    for first in range(0, len(here), BLOCK):
        frames = slice(first, first + BLOCK)
        counts = ((simulated[:, frames, :, None] == BIN_NUMBERS) & here[frames, :, None]).sum(axis=(0, 1))
        samples = np.maximum(len(simulated) * here[frames].sum(axis=0), 1)
        logs = np.log(smooth(counts / samples[:, None]))[np.arange(here.shape[1]), recorded[frames]]
        total += np.where(here[frames], logs, 0.0).sum(axis=0)
    return total / here.sum(axis=0)


def log_value(feature: str, simulated: PerRollout, recorded: PerPerson) -> PerPerson:
    """Return the log-likelihood of a feature with one value per person and rollout."""
    counts = (bins_of(feature, simulated)[..., None] == BIN_NUMBERS).sum(axis=0)
    return np.log(smooth(counts / len(simulated)))[np.arange(len(recorded)), bins_of(feature, recorded)]


def log_event(simulated: Bool[np.ndarray, "rollout person"], recorded: Bool[np.ndarray, "person"]) -> PerPerson:
    """Return the log-likelihood of an event that each person has or has not."""
    share = (1.0 - UNIFORM) * simulated.mean(axis=0) + UNIFORM / 2.0
    return np.log(np.where(recorded, share, 1.0 - share))


def smooth(share: Float[np.ndarray, "person bin"]) -> Float[np.ndarray, "person bin"]:
    """Return histograms after the kernel 1/4 1/2 1/4, mixed with a uniform distribution.

    At both ends the kernel's outer part stays in the bin. The last bin, of undefined values, is not smoothed.
    """
    inner = share[:, :BINS]
    padded = np.concatenate([inner[:, :1], inner, inner[:, -1:]], axis=1)
    kernel = padded[:, :-2] / 4.0 + inner / 2.0 + padded[:, 2:] / 4.0
    mixed = np.concatenate([kernel, share[:, BINS:]], axis=1)
    return (1.0 - UNIFORM) * mixed + UNIFORM / (BINS + 1)
