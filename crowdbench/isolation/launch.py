"""Replaces itself by a command under limits that the command inherits: `python -I -S launch.py SETTINGS COMMAND...`.

It runs twice. Outside of the sandbox, it joins a control group and a new keyring, and makes the filter of system calls
that bubblewrap loads. In the sandbox, it sets the limits of resources. It imports only the standard library, so that it
starts in some milliseconds.

SETTINGS is JSON: `group` (the folder of a control group), `cores` (their numbers), `filter` (the descriptor that gets
the filter), `rlimits` (limits by name, such as `NPROC`).
"""

from __future__ import annotations

import ctypes
import json
import os
import platform
import struct
import sys
from pathlib import Path
from typing import Any

MACHINES = {
    "x86_64": (0xC000003E, 9, "250 248 249 425 426 427 101 310 311 438 321 298 323 272 308 203 319 447 29 68 240"),
    "aarch64": (0xC00000B7, 222, "219 217 218 425 426 427 117 270 271 438 280 241 282 97 268 122 279 447 194 186 180"),
}
"""By machine: AUDIT_ARCH, the number of mmap, and the numbers of the calls that fail as if they did not exist.

They are keyctl, add_key, request_key (keys outlive a sandbox), the three of io_uring (they bypass the filter),
ptrace, process_vm_readv, process_vm_writev, pidfd_getfd, bpf, perf_event_open, userfaultfd, unshare, setns,
sched_setaffinity (a planner stays on the core on which it is timed), and memfd_create, memfd_secret, shmget, msgget,
mq_open (memory that is not counted for any process).
"""

_LOAD, _IF_EQUAL, _IF_AT_LEAST, _AND, _RETURN = 0x20, 0x15, 0x35, 0x54, 0x06
_ALLOW, _NO_SUCH_CALL, _KILL = 0x7FFF0000, 0x00050000 | 38, 0x80000000
_SHARED_ANONYMOUS = 0x21


def make_filter(machine: str) -> bytes:
    """Return the filter of system calls for a machine, a program of classic BPF."""
    architecture, mmap, numbers = MACHINES[machine]
    code = [(_LOAD, 0, 0, 4), (_IF_EQUAL, 1, 0, architecture), (_RETURN, 0, 0, _KILL)]  # numbers differ by machine
    code += [(_LOAD, 0, 0, 0), (_IF_AT_LEAST, 0, 1, 1 << 30), (_RETURN, 0, 0, _NO_SUCH_CALL)]  # calls of x32
    for number in map(int, numbers.split()):
        code += [(_IF_EQUAL, 0, 1, number), (_RETURN, 0, 0, _NO_SUCH_CALL)]
    # Shared memory without a file can exist without being counted for any process.
    code += [(_IF_EQUAL, 0, 4, mmap), (_LOAD, 0, 0, 40), (_AND, 0, 0, _SHARED_ANONYMOUS)]
    code += [(_IF_EQUAL, 0, 1, _SHARED_ANONYMOUS), (_RETURN, 0, 0, _NO_SUCH_CALL), (_RETURN, 0, 0, _ALLOW)]
    return b"".join(struct.pack("<HBBI", *instruction) for instruction in code)


def launch(settings: dict[str, Any], command: list[str]) -> None:
    """Set the limits and replace this process by the command."""
    import resource  # Windows has none

    if "group" in settings:
        Path(settings["group"], "cgroup.procs").write_text("0")
    if settings.get("cores"):
        os.sched_setaffinity(0, settings["cores"])
    if "filter" in settings:
        keyctl, join_session_keyring = int(MACHINES[platform.machine()][2].split()[0]), 1
        ctypes.CDLL(None).syscall(keyctl, join_session_keyring, None)  # it fails if the kernel has no keys
        file = os.memfd_create("filter", 0)
        os.write(file, make_filter(platform.machine()))
        os.lseek(file, 0, os.SEEK_SET)
        os.dup2(file, settings["filter"])
    for name, most in settings.get("rlimits", {}).items():
        kind = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]} cannot be started: {error.strerror}")


if __name__ == "__main__":
    launch(json.loads(sys.argv[1]), sys.argv[2:])
