"""All measurements of `crowdbench bench`, in the order of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from crowdbench.bench import commands, decisions, simulator
from crowdbench.bench.measurement import Measurement

SUITE: list[Callable[[], Iterator[Measurement]]] = [
    function
    for module in (simulator, decisions, commands)
    for name, function in vars(module).items()
    if name.startswith("measure_")
]
"""The functions of these modules whose names start with `measure_`, as they stand there."""
