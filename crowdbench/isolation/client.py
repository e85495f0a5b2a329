"""The planner's process: `python -m crowdbench.isolation.client` makes a planner and answers the parent's messages."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import signal
import sys
from collections.abc import Iterator
from io import FileIO, TextIOWrapper

import numpy as np

from crowdbench.catalog import load_planner
from crowdbench.isolation.protocol import (
    VERSION,
    FailureKind,
    MessageKind,
    ProtocolError,
    from_json,
    read_observation,
    receive,
    send,
    to_json,
)
from crowdbench.planners.planner import OneStepOnly, Planner
from crowdbench.planners.validation import AnswerFault, validate_array
from crowdbench.plugins.kind import plugin_name
from crowdbench.utils import interrupts
from crowdbench.utils.errors import InputError, describe_error, plugin_errors
from crowdbench.utils.resources import start_limit


def main() -> None:
    """Answer messages until the pipe is closed."""
    _die_with_parent()
    interrupts.handle()  # to distinguish Ctrl-C from a KeyboardInterrupt of the planner
    server = PlannerServer()
    with _own_streams() as (source, sink):
        try:
            while True:
                send(sink.write, *server.answer(*receive(source.readinto)))
        except ProtocolError:
            sys.exit(1)


@contextlib.contextmanager
def _own_streams() -> Iterator[tuple[FileIO, FileIO]]:
    """Reserve standard input and output for messages: text that the planner prints goes to standard error."""
    with FileIO(os.dup(0)) as source, FileIO(os.dup(1), "w") as sink, open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(2, 1)
        if isinstance(sys.stdout, TextIOWrapper):
            sys.stdout.reconfigure(line_buffering=True)  # the process may be killed
        yield source, sink


def _die_with_parent() -> None:
    """Let the kernel end this process if its parent ends, also during a decision of the planner."""
    if sys.platform == "linux":
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


class PlannerServer:
    """Server of the planner that the first message names; the planner answers the other messages."""

    name: str
    planner: Planner

    def answer(self, kind: MessageKind, content: bytearray) -> tuple[MessageKind, bytes]:
        """Return the answer to a message: its kind and its content."""
        try:
            if kind == MessageKind.START:
                return self._start(content)
            if kind == MessageKind.RESET:
                return self._reset(content)
            return self._decide(content)
        except InputError as error:
            return _failed(FailureKind.REFUSED, str(error))
        except OneStepOnly:
            return _failed(FailureKind.ONE_STEP, "")
        except BaseException as error:  # any exception of the planner, even SystemExit
            return _failed(FailureKind.FAULTY, f"raised {describe_error(error)}", getattr(error, "row", None))

    def _start(self, content: bytearray) -> tuple[MessageKind, bytes]:
        request = from_json(content)
        if request["version"] != VERSION:  # the parent reports the difference
            return MessageKind.READY, to_json({"version": VERSION})
        with start_limit(math.inf):  # the parent process limits it
            self.planner = load_planner(request["planner"], request["options"])
        self.name = plugin_name(request["planner"])
        if request.get("scene"):
            self.planner = self.planner.for_held_out_scene(request["scene"])
        properties = {
            "version": VERSION,
            "privileged": self.planner.privileged,
            "raw": self.planner.raw,
            "native": self.planner.native,
            "facts": dict(self.planner.facts),
        }
        with plugin_errors(f"planner {self.name} has privileged, raw, native and facts that cannot be sent:"):
            return MessageKind.READY, to_json(properties)

    def _reset(self, content: bytearray) -> tuple[MessageKind, bytes]:
        worlds = int(np.frombuffer(content, "<i8")[0])
        with plugin_errors(f"planner {self.name} raised", " in reset()"):
            self.planner.reset(np.arange(worlds))
        return MessageKind.READY, b""

    def _decide(self, content: bytearray) -> tuple[MessageKind, bytes]:
        obs, steps = read_observation(content)
        worlds = len(obs)  # read before the planner, which could change the observation
        # The parent process checks the numbers against the dynamics.
        if steps == 1:
            commands = validate_array(self.planner.plan(obs), worlds)
        else:
            commands = validate_array(self.planner.plan_ahead(obs, steps), worlds, steps)
        if isinstance(commands, AnswerFault):
            return _failed(FailureKind.FAULTY, commands.what, commands.row)
        return MessageKind.COMMANDS, np.ascontiguousarray(commands, "<f8").tobytes()


def _failed(how: FailureKind, what: str, row: int | None = None) -> tuple[MessageKind, bytes]:
    return MessageKind.FAILED, to_json({"how": how, "what": what, "row": row})


if __name__ == "__main__":
    main()
