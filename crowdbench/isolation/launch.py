"""Replaces itself by a command under limits that the command inherits: `python -I -S launch.py SETTINGS COMMAND...`.

It runs twice. Outside of the sandbox, it joins a control group and a new keyring, and makes the filter of system calls
that bubblewrap loads. In the sandbox, it sets the limits of resources and the user. It imports only the standard
library, so that it starts in some milliseconds.

SETTINGS is JSON: `group` (the folder of a control group), `cores` (their numbers), `filter` (the descriptor that gets
the filter), `owner` (a user who may open the standard streams again, as `/dev/stderr`), `rlimits` (limits by name, such
as `NPROC`), `user` (the user to become).
"""

from __future__ import annotations

import csv
import ctypes
import json
import os
import platform
import stat
import struct
import sys
from pathlib import Path
from typing import Any

MACHINES = {"x86_64": (0xC000003E, 250), "aarch64": (0xC00000B7, 219)}
"""By machine: AUDIT_ARCH, and the number of keyctl."""

CALLS = Path(__file__).with_name("system_calls.csv")
"""The system calls that a planner may use, with their numbers by machine; all others fail as if they did not exist."""

_COMMANDS_OF_FILES = (0, 1, 2, 3, 4, 1030, 1032)  # copies, flags, and the size of a pipe; no locks
_QUESTIONS_TO_FILES = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)  # TCGETS, TIOCGWINSZ, FIONREAD, FIONBIO, FIOCLEX
_ADVICE = (0, 1, 2, 3, 4, 8, 10, 11, 14, 15, 16, 17, 18, 19, 22, 23)  # none that empties or shows the page cache
_LIMITS = (0, 1, 2, 3, *range(5, 16))  # not of core dumps, which the machine may send to a program of root
_FACTS_OF_PROCESSES = (1, 2, 3, 15, 16, 23, 24, 38, 39)  # end with the parent, name, and what can only be given up

ONLY = {
    "fcntl": (1, _COMMANDS_OF_FILES),
    "ioctl": (1, _QUESTIONS_TO_FILES),
    "madvise": (2, _ADVICE),
    "setrlimit": (0, _LIMITS),
    "prlimit64": (1, _LIMITS),
    "prctl": (0, _FACTS_OF_PROCESSES),
    "socketpair": (0, (1,)),  # AF_UNIX
}
"""By call: an argument, and the values that it may have."""

WITHOUT = {
    # Shared memory without a file, and huge pages, can exist without being counted for any process.
    "mmap": (3, (0x21, 0x40000)),
    "clone": (0, (0x20000, *(1 << bit for bit in range(25, 31)))),  # new namespaces
}
"""By call: an argument, and combinations of bits that it may not have."""

_LOAD, _IF_EQUAL, _IF_AT_LEAST, _AND, _RETURN = 0x20, 0x15, 0x35, 0x54, 0x06
_ALLOW, _NO_SUCH_CALL, _KILL = 0x7FFF0000, 0x00050000 | 38, 0x80000000
_FIRST_OF_X32 = 1 << 30

Code = list[tuple[int, int, int, int]]


def make_filter(machine: str) -> bytes:
    """Return the filter of system calls for a machine, a program of classic BPF."""
    code: Code = [(_LOAD, 0, 0, 4), (_IF_EQUAL, 1, 0, MACHINES[machine][0])]
    code += [(_RETURN, 0, 0, _KILL)]  # numbers differ by machine
    code += [(_LOAD, 0, 0, 0), (_IF_AT_LEAST, 0, 1, _FIRST_OF_X32), (_RETURN, 0, 0, _NO_SUCH_CALL)]
    with CALLS.open() as file:
        for row in csv.DictReader(file):
            if row[machine]:
                decide = _decide(row["call"])
                code += [(_IF_EQUAL, 0, len(decide), int(row[machine])), *decide]
    code += [(_RETURN, 0, 0, _NO_SUCH_CALL)]
    return b"".join(struct.pack("<HBBI", *instruction) for instruction in code)


def _decide(call: str) -> Code:
    """Return the instructions that decide on a call of the list by the low half of an argument."""
    code: Code = []
    if call in ONLY:
        argument, values = ONLY[call]
        code += [(_LOAD, 0, 0, 16 + 8 * argument)]
        for value in values:
            code += [(_IF_EQUAL, 0, 1, value), (_RETURN, 0, 0, _ALLOW)]
        return [*code, (_RETURN, 0, 0, _NO_SUCH_CALL)]
    argument, combinations = WITHOUT.get(call, (0, ()))
    for bits in combinations:
        code += [(_LOAD, 0, 0, 16 + 8 * argument), (_AND, 0, 0, bits)]
        code += [(_IF_EQUAL, 0, 1, bits), (_RETURN, 0, 0, _NO_SUCH_CALL)]
    return [*code, (_RETURN, 0, 0, _ALLOW)]


def launch(settings: dict[str, Any], command: list[str]) -> None:
    """Set the limits and replace this process by the command."""
    import resource  # Windows has none

    if "group" in settings:
        Path(settings["group"], "cgroup.procs").write_text("0")
    if settings.get("cores"):
        os.sched_setaffinity(0, settings["cores"])
    if "filter" in settings:
        keyctl, join_session_keyring = MACHINES[platform.machine()][1], 1
        ctypes.CDLL(None).syscall(keyctl, join_session_keyring, None)  # it fails if the kernel has no keys
        file = os.memfd_create("filter")
        os.write(file, make_filter(platform.machine()))
        os.lseek(file, 0, os.SEEK_SET)
        os.dup2(file, settings["filter"])
    if "owner" in settings:
        for stream in range(3):
            if stat.S_ISFIFO(os.fstat(stream).st_mode):
                os.fchown(stream, settings["owner"], settings["owner"])
    for name, most in settings.get("rlimits", {}).items():
        kind = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)
    if "user" in settings:
        _become(settings["user"])
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]} cannot be started: {error.strerror}")


def _become(user: int) -> None:
    """Give up the rights of root for good."""
    libc = ctypes.CDLL(None)
    drop_from_bounding_set, last_capability = 24, 63
    for capability in range(last_capability + 1):
        libc.prctl(drop_from_bounding_set, capability)
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
    libc.capset(struct.pack("<Ii", 0x20080522, 0), bytes(24))  # the inheritable ones too


if __name__ == "__main__":
    launch(json.loads(sys.argv[1]), sys.argv[2:])
