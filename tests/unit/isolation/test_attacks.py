"""Programs that try to leave their sandbox, to tell something to the next one, or to read what others left."""

import csv
import platform
import re
from pathlib import Path

import psutil
import pytest
from attacking_program import ATTACKS
from probes import made

from crowdbench.isolation import sandbox
from crowdbench.isolation.launch import CALLS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]

PROGRAM = Path(__file__).with_name("attacking_program.py")

REFUSED_OTHERWISE = {
    "write to the kernel's settings (B7)": "No such file",
    "write to any file of the kernel": "nothing was found",
    "read the kernel's settings": "nothing was found",
    "read about the machine and other processes": "nothing was found",
    "write to the sandbox's first process": "No such file|Permission denied",
    "sockets of any family (B8)": "nothing was found",
    "pairs of sockets of other families": "nothing was found",
    "os.preadv, without waiting": "not supported",  # glibc's own words for a call that does not exist
    "a file in memory that it inherits": "nothing was found",
    "shared memory of /dev/zero": "Permission denied",
    "calls of 32 bits": "status -31|this machine has none",
    "calls of x32": "not implemented|this machine has none",
}
"""By attack: the reason, if it is not that the system call does not exist."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """What each attack reports, by its name."""
    body = (
        f"sys.path.insert(0, {str(PROGRAM.parent)!r})\n"
        "import attacking_program\n"
        "return Probe(attacking_program.outcomes())"
    )
    with made(tmp_path_factory.mktemp("attacks"), body, options={"file": str(PROGRAM)}) as planner:
        return planner.facts


@pytest.mark.parametrize("name", ATTACKS)
def test_an_attack_is_refused(name, outcomes):
    reason = REFUSED_OTHERWISE.get(name, "Function not implemented")
    assert re.match(f"refused: .*({reason})", outcomes[name])


def test_every_system_call_outside_of_the_list_fails(tmp_path):
    with CALLS.open() as file:
        known = [int(row[platform.machine()] or 0) for row in csv.DictReader(file)]
    known += [335, 336]  # those of probes on x86-64, which no filter sees, end the process
    body = f"""
libc = ctypes.CDLL(None, use_errno=True)
def error(number):
    ctypes.set_errno(0)
    libc.syscall(ctypes.c_long(number), *[ctypes.c_long(0)] * 6)
    return ctypes.get_errno()
return Probe(there=str([number for number in range(700) if number not in {known} and error(number) != 38]))
"""
    with made(tmp_path, body) as planner:
        assert planner.facts == {"there": "[]"}


def test_a_planner_is_not_root_of_the_machine(tmp_path):
    with made(tmp_path, "return Probe()") as planner:
        planners = [psutil.Process(pid) for pid in planner.process.usage.processes()]
        users = [one.uids() for one in planners if tuple(one.cmdline()[1:]) == sandbox.CLIENT[1:]]
    assert len(users) == 1
    assert 0 not in users[0]
