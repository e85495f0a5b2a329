"""Planner that runs in a separate process, with the interface of a planner for the parent process."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.types import Observation
from crowdbench.isolation import sandbox
from crowdbench.isolation.limits import Exceeded, Usage, describe_limits
from crowdbench.isolation.process import Process, TooSlow
from crowdbench.isolation.protocol import (
    VERSION,
    FailureKind,
    MessageKind,
    ProtocolError,
    from_json,
    observation_parts,
    read_commands,
    to_json,
)
from crowdbench.isolation.untrusted_text import one_line
from crowdbench.planners.driver import FaultyAnswer
from crowdbench.planners.planner import AheadPlanner, OneStepOnly
from crowdbench.planners.validation import AnswerFault
from crowdbench.plugins.kind import file_and_function, plugin_name, program
from crowdbench.plugins.plugin_files import read_files
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import LONGEST, InputError, MachineFault
from crowdbench.utils.resources import TimeLimit


@dataclass(frozen=True)
class ResourceLimits:
    """Limits of a planner's process.

    Attributes:
        construction: Seconds for the construction of the planner, including the start of Python.
        decision: Seconds for a decision of a whole batch, and for `reset`.
        total: Seconds for all answers together.
        memory: Bytes of memory, including the memory of its child processes.
    """

    construction: float = 120.0
    decision: float = DECISION_LIMIT
    total: float = math.inf
    memory: float = 8e9


Answer = TypeVar("Answer")

LIMITS = ResourceLimits()
"""The default limits."""


class IsolatedPlanner(AheadPlanner):
    """A planner in a separate process. Its logs are not recorded.

    The parent process never loads the planner's code, which could change the parent.

    Attributes:
        name: Its name in errors.
        limits: Its limits.
        process: Its process.
        usage: Its level of isolation, and the resources that it has used so far, for results.

    Args:
        spec: The name of a planner, `file.py` or `file.py:function`, or a program that reads and writes the messages
            of `crowdbench.isolation.protocol`.
        options: Arguments of the planner's function, as written in TOML.
        readable: Files that it may read in its sandbox in addition to Python and crowdbench; if None, its files and
            the files that its options name.
        folder: Its working directory; the present one if None.
        hidden: Folders that it must not read, even if they are in a folder that it may read.
        scene: The recorded scene that it must not have been trained on, if any: see `Planner.for_held_out_scene`.
        decimals: Number of decimal places to which its commands are rounded towards 0 before they are used; None for no
            rounding. Otherwise the low digits can be a hidden channel between two processes of one planner.
        cores: The processors that it may use; by default all processors of this process.

    Raises:
        InputError: The planner cannot be constructed, or exceeds its limit of time or memory.
        MachineFault: Its process runs another version of crowdbench.
    """

    def __init__(
        self,
        spec: str,
        options: Mapping[str, Any],
        limits: ResourceLimits = LIMITS,
        *,
        readable: Iterable[Path] | None = None,
        folder: Path | None = None,
        hidden: Iterable[Path] = (),
        scene: str | None = None,
        decimals: int | None = None,
        cores: Sequence[int] | None = None,
    ) -> None:
        self.name = plugin_name(spec)
        self.limits, self.decimals = limits, decimals
        self.usage: dict[str, Any] = {"level": sandbox.level(), "limits": describe_limits()}
        readable = [*_files_named_in(spec), *_files_named_in(options)] if readable is None else readable
        command = sandbox.command(program(spec), readable, folder, hidden)
        usage = Usage(limits.memory, cores, sandbox.temporary())
        self.process = Process(self.name, command, sandbox.settings(), usage, folder)
        try:
            properties = self._start(spec, options, scene)
        except BaseException:
            self.close()
            raise
        self.privileged = properties.get("privileged")  # type: ignore[assignment]  # checked by the driver
        self.facts = properties.get("facts", {})
        self.raw = properties.get("raw", False)
        self.native = properties.get("native", False)
        self.usage["construction_seconds"] = self.process.seconds

    def _start(self, spec: str, options: Mapping[str, Any], scene: str | None) -> dict[str, Any]:
        """Construct the planner, and return its properties. The driver checks them, except for the version."""
        request = {"version": VERSION, "planner": spec, "options": dict(options)}
        if scene:
            request["scene"] = scene
        limit = self.limits.construction
        properties = self._ask(from_json, "in its construction", limit, MessageKind.START, to_json(request))
        version = properties.get("version")
        if version != VERSION and program(spec) is None:
            raise MachineFault(
                f"crowdbench has changed since this command started, so that planner {self.name} cannot be used: "
                f"its messages are of version {VERSION} here and of version {version!r} there; start the command again"
            )
        if version != VERSION:
            raise InputError(
                f"planner {self.name} uses version {version!r} of the messages, but must use version {VERSION}, "
                "which docs/isolation.md describes"
            )
        return properties

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self._ask(bytes, "in reset()", self.limits.decision, MessageKind.RESET, np.int64(len(rows)).tobytes())

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `Planner`."""
        read = functools.partial(read_commands, worlds=len(obs), steps=steps)
        commands = self._ask(read, "", self.limits.decision, MessageKind.OBSERVATION, *observation_parts(obs, steps))
        if self.decimals is None:
            return commands
        unit = 10.0**self.decimals
        # Towards 0, so that no command exceeds the limits of the vehicle. Rounded commands do not change.
        return np.trunc(commands * unit * (1.0 + 1e-12)) / unit

    def close(self) -> None:
        """End the process. The planner cannot be queried again."""
        self.process.end()

    def _ask(
        self,
        read: Callable[[bytearray], Answer],
        where: str,
        limit: float,
        kind: MessageKind,
        *parts: bytes | memoryview,
    ) -> Answer:
        """Send a message to the process and return the answer.

        Args:
            read: Reads the content of the answer.
            where: The call for which the message is sent, for errors; empty for a decision.
            limit: Longest time for the answer in seconds.

        Raises:
            InputError: The planner failed in construction or `reset`, or reports an error itself.
            FaultyAnswer: It failed in a decision.
            TimeLimit: It took too long in a decision.
            OneStepOnly: It decides one step at a time.
        """
        left = self.limits.total - self.process.spent
        try:
            answer, content = self.process.ask(min(limit, left), kind, *parts)
            if answer == MessageKind.FAILED:
                raise self._failure(where, from_json(content))
            expected = MessageKind.COMMANDS if kind == MessageKind.OBSERVATION else MessageKind.READY
            if answer != expected:
                raise ProtocolError(f"sent a message of kind {answer} where another was due")
            return read(content)
        except TooSlow:
            if left < limit:
                total = f"{self.limits.total:g} s for all its answers together"
                raise self._fault(f"took longer than {total}", where) from None
            if not where:
                raise TimeLimit from None
            raise self._fault(f"took longer than {limit:g} s", where) from None
        except (ProtocolError, Exceeded) as error:
            raise self._fault(str(error), where) from None
        finally:
            self.usage["peak_memory_mb"] = self.process.usage.memory / 1e6

    def _fault(self, what: str, where: str, row: int | None = None) -> Exception:
        if where:
            return InputError(f"planner {self.name} {what} {where}")
        return FaultyAnswer(AnswerFault(what, row))

    def _failure(self, where: str, failure: Mapping[str, Any]) -> Exception:
        """Return the exception for a planner that reports a failure. The report is not trusted."""
        how, what, row = failure.get("how"), str(failure.get("what", "")), failure.get("row")
        sentence = one_line(what, LONGEST)
        if how == FailureKind.REFUSED:
            return InputError(sentence)
        if how == FailureKind.ONE_STEP:
            return OneStepOnly()
        return self._fault(sentence, where, row if isinstance(row, int) else None)


def _files_named_in(value: Any) -> Iterator[Path]:
    """Yield the paths named in a planner or an option: a folder, or a file with its imports and accompanying files."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from _files_named_in(item)
    elif isinstance(value, str) and "\0" not in value:
        path = file_and_function(value)[0] or Path(value)
        if path.is_file():
            yield path
            for name in read_files(path):
                yield path.resolve().parent / name
        elif path.is_dir():
            yield path
