"""Drives with the policy in an ONNX file, `--planner policy.onnx`. Reading the file runs no code.

`crowdbench.export_policy` writes such files, with the training conditions of the policy as metadata. There is one
input, or one for each key of an observation `dict`. The first axis of an input is the batch: it is dynamic or fixed, or
is missing if the network computes one world. Inputs whose name begins with `state` are the memory of a recurrent
policy. The first output is the action, the others are the new memory, in the order of these inputs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.planners.policy_planner import PolicyPlanner
from crowdbench.utils.commands import command
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.files import read_regular
from crowdbench.views.view import NEAREST

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

METADATA = "crowdbench"
"""Metadata key of the training conditions of a policy.

JSON of a table with `observation`, `action`, `nearest` and `rays` (see `PolicyPlanner`), `scenario` (its name),
`dynamics` (of the vehicle), `dt` (in seconds), and `pedestrians` (their largest number). Each may be missing.
Normalisation and squashing are in the graph.
"""

STATE = "state"
"""Prefix of the inputs that hold the memory of a recurrent policy."""

NO_BATCH = 0
"""The batch of a network whose inputs have no batch axis: it computes one world."""

TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}


def load_onnx(
    file: Path,
    observation: str | None = None,
    action: str | None = None,
    nearest: int | None = None,
    dynamics: str | None = None,
) -> PolicyPlanner:
    """Make the planner of a policy in an ONNX file.

    Args:
        file: The file.
        observation: Observation of the policy: flat, goal_frame, dict or lidar; by default as in the metadata.
        action: Its actions, such as normalized, velocity or goal_frame; by default as in the metadata.
        nearest: Largest number of pedestrians that it observes; by default as in the metadata, or 10.
        dynamics: The vehicles that it may drive: holonomic, unicycle or bicycle; by default as in the metadata, or any.

    Raises:
        InputError: The file cannot be read, or an option is missing.
    """
    if file.suffix != ".onnx":
        model, onnx = f"PPO.load({str(file)!r})" if file.suffix == ".zip" else "model", str(file.with_suffix(".onnx"))
        raise InputError(
            f"{file} holds code, which crowdbench does not run: in Python, crowdbench.export_policy({model}, {onnx!r}, "
            f"env) exports the policy for --planner {onnx}"
        )
    session, trained = _read(file)
    given = {"observation": observation, "action": action, "nearest": nearest, "dynamics": dynamics}
    trained |= {name: value for name, value in given.items() if value is not None}
    if missing := [name for name in ("observation", "action") if name not in trained]:
        options = " ".join(f"--option {name}=goal_frame" for name in missing)
        about = command("list", "planners", file)
        raise InputError(f"{file} has no metadata of its training: give {options}; see {about}")
    batch = _read_batch(file, session)
    first = 0 if batch == NO_BATCH else 1  # axis of the state of one world
    state = [tuple(one.shape[first:]) for one in session.get_inputs() if one.name.startswith(STATE)]
    view = trained["observation"], trained["action"], trained.get("nearest", NEAREST)
    more = trained.get("dynamics"), trained.get("rays", 0), "float64"  # the inputs of the network are cast to its types
    planner = PolicyPlanner(_function(file, session, batch), *view, state, *more)
    planner.trained_pedestrians = int(trained["pedestrians"]) if "pedestrians" in trained else None
    planner.trained_dt = float(trained["dt"]) if "dt" in trained else None
    return planner


def _read(file: Path) -> tuple[InferenceSession, dict[str, Any]]:
    """Read a file and its metadata. External data are not read, because results have only the digest of this file."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # otherwise it sends usage data
    try:
        import onnxruntime
    except ImportError:
        raise InputError(f"{file} needs ONNX Runtime: pip install 'crowdbench[onnx]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised
    with plugin_errors(f"{file} cannot be read as an ONNX file:"):
        session = onnxruntime.InferenceSession(read_regular(file), options, providers=["CPUExecutionProvider"])
        return session, dict(json.loads(session.get_modelmeta().custom_metadata_map.get(METADATA, "{}")))


def _read_batch(file: Path, session: InferenceSession) -> int | None:
    """Return the fixed batch of a network, `NO_BATCH` if its inputs have no batch axis, or None if it is dynamic.

    Raises InputError if its inputs have different fixed batches.
    """
    inputs = session.get_inputs()
    if any(len(one.shape) == 1 for one in inputs if not one.name.startswith(STATE)):
        return NO_BATCH
    batches = {one.name: one.shape[0] for one in inputs if one.shape and isinstance(one.shape[0], int)}
    if len(set(batches.values())) > 1:
        found = ", ".join(f"{batch} in {name}" for name, batch in batches.items())
        raise InputError(f"{file}: the first axis of all inputs must be the same batch, but is {found}")
    return next(iter(batches.values()), None)


def _function(file: Path, session: InferenceSession, batch: int | None) -> Callable[..., Any]:
    """Return a network as the function of a `PolicyPlanner`.

    Args:
        file: The file of the network.
        session: The network.
        batch: Its batch, see `_read_batch`.
    """
    types = {one.name: TYPES.get(one.type, np.float32) for one in session.get_inputs()}
    memory = [name for name in types if name.startswith(STATE)]

    def act(observed: Any, *state: np.ndarray) -> Any:
        shown = observed if isinstance(observed, dict) else dict.fromkeys(types, observed)
        arrays = {**shown, **dict(zip(memory, state, strict=True))}
        with plugin_errors(f"{file} does not fit the scenario, or option observation or nearest:"):
            inputs = {name: arrays[name].astype(kind) for name, kind in types.items()}
            answer = _run(session, inputs, [(-1,), *(one.shape[1:] for one in state)], batch)
        return answer if state else answer[0]

    return act


def _run(
    session: InferenceSession, inputs: Mapping[str, np.ndarray], shapes: Sequence[tuple[int, ...]], batch: int | None
) -> list[np.ndarray]:
    """Run a network on all worlds. The last world fills up its last batch.

    Args:
        session: The network.
        inputs: Arrays `[world, ...]` by name.
        shapes: The shapes of its outputs for one world, which may lack their batch axis in a batch of one world.
        batch: Its batch, see `_read_batch`.

    Returns:
        Its outputs `[world, ...]`.
    """
    number = len(next(iter(inputs.values())))
    size = number if batch is None else max(batch, 1)
    parts = []
    for start in range(0, number, size):
        rows = np.arange(start, start + size).clip(max=number - 1)
        part = {name: array[start if batch == NO_BATCH else rows] for name, array in inputs.items()}
        outputs = session.run(None, part)[: len(shapes)]
        if size == 1:
            outputs = [output.reshape(1, *shape) for output, shape in zip(outputs, shapes, strict=True)]
        parts.append([output[: number - start] for output in outputs])
    return [np.concatenate(part) for part in zip(*parts, strict=True)]
