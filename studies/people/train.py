"""Train the network of the pedestrian policy `learned_people` on recorded people."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import help_from_docstring, main
from crowdbench.utils import write_whole

if TYPE_CHECKING:
    from studies.people.windows import Window

AHEAD = 3
"""Frames of 0.4 s over which the network predicts the mean velocity."""

HIDDEN, EPOCHS, BATCH, RATE, DECAY, MIRRORED = 48, 60, 512, 2e-3, 1e-3, (1.0, -1.0)


@help_from_docstring
def train(
    data: Annotated[Path, typer.Option()],
    out: Annotated[Path, typer.Option()],
    held_out: str = "",
    seed: int = 0,
) -> None:
    """Train the network on all locations but one, and write the policy and its weights.

    Args:
        data: The folder with the tracks of ETH/UCY.
        out: The folder of the policy, `learned_people.py`, and its weights.
        held_out: The location that takes no part; none if not given.
        seed: Seed of the initial weights and of the order of the examples.
    """
    from safetensors.numpy import save

    from agents.pedestrians.learned_people import learned_people
    from studies.people.windows import FOLDS, read_windows

    if held_out and held_out not in FOLDS:
        raise InputError(f"--held-out is {held_out!r}, but must be one of {', '.join(FOLDS)}")
    locations = [name for name in FOLDS if name != held_out]
    windows = [window for each in read_windows(data, locations).values() for window in each]
    weights = learn(windows, seed)
    out.mkdir(parents=True, exist_ok=True)
    source = Path(learned_people.__file__)
    for path, content in ((out / source.name, source.read_bytes()), (out / learned_people.WEIGHTS.name, save(weights))):
        with write_whole(path) as file:
            file.write_bytes(content)


def learn(windows: Sequence[Window], seed: int) -> dict[str, np.ndarray]:
    """Return the weights of a network that has learned from windows."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    observed, change = map(torch.as_tensor, examples(windows))
    layers = [torch.nn.Linear(observed.shape[1], HIDDEN), torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Linear(HIDDEN, 2)]
    network = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2]).double()
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    for epoch in range(EPOCHS):
        total = 0.0
        for rows in torch.randperm(len(observed)).split(BATCH):  # type: ignore[no-untyped-call]
            loss = torch.nn.functional.huber_loss(network(observed[rows]), change[rows], delta=0.3)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            total += float(loss.detach()) * len(rows)
        schedule.step()
        if epoch % 10 == 9:
            print(f"epoch {epoch + 1}: {total / len(observed):.5f}", flush=True)
    arrays = {}
    for number, layer in enumerate(layers):
        arrays[f"b{number}"] = layer.bias.detach().numpy().astype(np.float32)
        arrays[f"w{number}"] = layer.weight.detach().numpy().astype(np.float32)
    return arrays


def examples(windows: Sequence[Window]) -> tuple[np.ndarray, np.ndarray]:
    """Return what people observed, and the change of their mean velocity in the next frames, in their own frame."""
    from agents.pedestrians.learned_people.learned_people import observe
    from crowdbench.scenario import ETH_UCY_DT
    from studies.people.windows import FUTURE, HISTORY

    rows, changes = [], []
    for window in windows:
        goal = window.goals(hidden=False)
        for time in range(1, HISTORY + FUTURE - AHEAD + 1):
            here, before, later = (window.position[time + shift] for shift in (0, -1, AHEAD))
            velocity = (here - before) / ETH_UCY_DT
            present = np.isfinite(velocity[:, 0])
            used = present & np.isfinite(later[:, 0])
            if not used.any():
                continue
            to_goal = goal - here
            distance = np.linalg.norm(to_goal, axis=1, keepdims=True)
            ahead = to_goal / np.maximum(distance, 1e-9)
            left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
            target = (later - here) / (AHEAD * ETH_UCY_DT)
            pace = np.minimum(window.speed, distance[:, 0])
            change = np.stack([(target * ahead).sum(axis=1) - pace, (target * left).sum(axis=1)], axis=1)
            for sign in MIRRORED:
                flip = np.array([1.0, sign])
                seen = observe(
                    *(np.nan_to_num(part[None] * flip) for part in (here, velocity, goal)),
                    window.speed[None],
                    present[None],
                )
                rows.append(seen[0][used])
                changes.append((change * flip)[used])
    return np.concatenate(rows), np.concatenate(changes)


if __name__ == "__main__":
    main(train)
