"""The filter of system calls of each machine, run by an interpreter of classic BPF."""

import csv
import ctypes
import ctypes.util
import functools
import struct

import pytest

from crowdbench.isolation.launch import CALLS, MACHINES, make_filter

ALLOWED, REFUSED, KILLED = 0x7FFF0000, 0x00050026, 0x80000000

pytestmark = pytest.mark.parametrize("machine", MACHINES)


@functools.cache
def program(machine):
    """The instructions of a machine's filter."""
    return list(struct.iter_unpack("<HBBI", make_filter(machine)))


@functools.cache
def numbers(machine):
    """The number of each call of the list on a machine, by name."""
    with CALLS.open() as file:
        return {row["call"]: int(row[machine]) for row in csv.DictReader(file) if row[machine]}


def verdict(machine, number, *arguments, architecture=None):
    """What the filter says of a system call."""
    architecture = MACHINES[machine][0] if architecture is None else architecture
    data = struct.pack("<iIQ6Q", number, architecture, 0, *arguments, *[0] * (6 - len(arguments)))
    code, at, value = program(machine), 0, 0
    while True:
        operation, yes, no, constant = code[at]
        at += 1
        match operation:
            case 0x20:
                (value,) = struct.unpack_from("<I", data, constant)
            case 0x54:
                value &= constant
            case 0x15:
                at += yes if value == constant else no
            case 0x35:
                at += yes if value >= constant else no
            case 0x06:
                return constant


def test_calls_of_the_list_are_allowed_and_others_are_not(machine):
    known = numbers(machine)
    assert len(set(known.values())) == len(known)
    assert {verdict(machine, known[name]) for name in ("read", "execve", "futex", "openat", "mmap", "clone")} == {
        ALLOWED
    }
    others = set(range(1000)) - set(known.values())
    assert {verdict(machine, number) for number in others} == {REFUSED}


def test_calls_of_another_architecture_end_the_process(machine):
    assert verdict(machine, numbers(machine)["read"], architecture=0x40000003) == KILLED


def test_calls_of_x32_are_refused(machine):
    assert verdict(machine, 1 << 30 | numbers(machine)["read"]) == REFUSED


ARGUMENTS = {
    "a thread": ("clone", (0x3D0F00,), ALLOWED),
    "a process": ("clone", (0x1200011,), ALLOWED),
    "new mounts": ("clone", (0x20011,), REFUSED),
    "new control groups": ("clone", (0x2000011,), REFUSED),
    "new names of the machine": ("clone", (0x4000011,), REFUSED),
    "new messages": ("clone", (0x8000011,), REFUSED),
    "new users": ("clone", (0x10000011,), REFUSED),
    "new processes": ("clone", (0x20000011,), REFUSED),
    "a new network": ("clone", (0x40000011,), REFUSED),
    "private memory": ("mmap", (0, 4096, 3, 0x22), ALLOWED),
    "a shared file": ("mmap", (0, 4096, 3, 0x1), ALLOWED),
    "shared memory": ("mmap", (0, 4096, 3, 0x21), REFUSED),
    "huge pages": ("mmap", (0, 4096, 3, 0x40022), REFUSED),
    "memory is no longer needed": ("madvise", (0, 4096, 4), ALLOWED),
    "page out": ("madvise", (0, 4096, 21), REFUSED),
    "a lock on a part of a file": ("fcntl", (3, 6), REFUSED),
    "a lock on a part of an open file": ("fcntl", (3, 37), REFUSED),
    "flags of a file": ("fcntl", (3, 4), ALLOWED),
    "a larger pipe": ("fcntl", (3, 1031), REFUSED),
    "a terminal?": ("ioctl", (3, 0x5401), ALLOWED),
    "type into a terminal": ("ioctl", (3, 0x5412), REFUSED),
    "a limit of files": ("prlimit64", (0, 7), ALLOWED),
    "a limit of core dumps": ("prlimit64", (0, 4), REFUSED),
    "a name": ("prctl", (15,), ALLOWED),
    "hide from others": ("prctl", (4,), REFUSED),
    "local sockets": ("socketpair", (1, 1), ALLOWED),
    "sockets of TIPC": ("socketpair", (30, 1), REFUSED),
}


@pytest.mark.parametrize("what", ARGUMENTS)
def test_arguments_decide(what, machine):
    call, arguments, expected = ARGUMENTS[what]
    assert verdict(machine, numbers(machine)[call], *arguments) == expected


def test_the_numbers_are_those_of_libseccomp(machine):
    name = ctypes.util.find_library("seccomp")
    if name is None:
        pytest.skip("libseccomp is not there")
    resolve = ctypes.CDLL(name).seccomp_syscall_resolve_name_arch
    resolved = {call: resolve(MACHINES[machine][0], call.encode()) for call in numbers(machine)}
    assert resolved == numbers(machine)
