"""Write a table of the steps of a run, `steps.parquet`, for learning from demonstrations.

A row per step: case, step, observation of the environments, action, CrowdNav's reward, terminated, truncated. Steps of
stored tracks have no observation, and their action is the velocity in m/s.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from crowdbench.core.reward import episode_rewards
from crowdbench.core.types import Outcome, Trace, World
from crowdbench.views.ego import flatten_vehicle

STEPS = "steps.parquet"


class StepWriter(contextlib.ExitStack):
    """Writer of the steps of several traces into a file, in a `with` statement.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self._writer: pq.ParquetWriter | None = None
        self._observed: dict[tuple[int, int], Float[np.ndarray, "features"]] = {}

    def watch(self, world: World) -> None:
        """Store the observations before a step of a simulation, in the format of the environments."""
        numbers = zip(world.case.tolist(), world.step.tolist(), strict=True)
        self._observed.update(zip(numbers, flatten_vehicle(world), strict=True))

    def write(self, trace: Trace) -> None:
        """Write the steps of a trace, with the observations that were stored since the trace before it."""
        table = self._tabulate(trace)
        if self._writer is None:
            self._writer = self.enter_context(pq.ParquetWriter(self.path, table.schema, compression="zstd"))
        self._writer.write_table(table)
        self._observed.clear()

    def _tabulate(self, trace: Trace) -> pa.Table:
        """Return a table with a row for each step of a trace."""
        cases = list(zip(trace.case.tolist(), trace.steps.tolist(), strict=True))
        is_last = np.concatenate([np.arange(steps) == steps - 1 for _, steps in cases])
        outcome = np.repeat(trace.outcome, trace.steps)
        inside = np.arange(trace.command.shape[1]) < trace.steps[:, None]
        columns = {
            "case": pa.array(np.repeat(trace.case, trace.steps)),
            "step": pa.array(np.concatenate([np.arange(steps) for _, steps in cases])),
        }
        if self._observed:
            observations = [self._observed[case, step] for case, steps in cases for step in range(steps)]
            columns["observation"] = _rows(np.stack(observations))
        columns |= {
            "action": _rows(trace.command[inside]),
            "reward": pa.array(episode_rewards(trace)[inside]),
            "terminated": pa.array(is_last & (outcome != Outcome.TIMEOUT)),
            "truncated": pa.array(is_last & (outcome == Outcome.TIMEOUT)),
        }
        return pa.table(columns)


def _rows(values: Float[np.ndarray, "row _"]) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
