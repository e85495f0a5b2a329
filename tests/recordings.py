"""A small synthetic recording: pedestrians cross an area of 12 m x 6 m for two minutes, and one stands in it."""

import numpy as np

from crowdbench.catalog import load_scenario

SECONDS, DT = 120.0, 0.4

TOML = """
time_limit = 10.0

[tracks]
scene = "mine"
distance = 4.0

[pedestrians]
policy = "recorded"
"""


def rows():
    """Lines of a file in the format of ETH/UCY: every 4 s somebody comes and walks across in 8 s."""
    found = [(frame, 99, 6.0, 5.5) for frame in range(int(SECONDS / DT) + 1)]
    for number in range(int(SECONDS / 4) - 2):
        first, y = number * 10, 0.5 + number % 5
        for k in range(21):
            x = 0.6 * k if number % 2 else 12.0 - 0.6 * k
            found.append((first + k, number, x, y + 0.3 * np.sin(k / 3)))
    return [(10 * frame, person, x, y) for frame, person, x, y in found]


def write(folder, toml=TOML):
    """A folder with the recording and a scenario of it; returns the scenario's file."""
    (folder / "mine.txt").write_text("".join(f"{f}\t{p}\t{x:.6f}\t{y:.6f}\n" for f, p, x, y in rows()))
    (folder / "mine.toml").write_text(toml)
    return folder / "mine.toml"


def scenario(folder, **overrides):
    """The scenario in which the recording is the crowd; overrides use `__` for dots."""
    file = write(folder)
    return load_scenario(str(file), {key.replace("__", "."): value for key, value in overrides.items()}, data=folder)
