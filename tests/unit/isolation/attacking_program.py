"""Attacks on the sandbox, for a planner that runs in it: each raises OSError, or returns what it got."""

import array
import contextlib
import ctypes
import fcntl
import mmap
import os
import platform
import signal
import socket
import struct

LIBC = ctypes.CDLL(None, use_errno=True)

NUMBERS = {
    "add_key": (248, 217),
    "bpf": (321, 280),
    "cachestat": (451, 451),
    "chroot": (161, 51),
    "clone": (56, 220),
    "clone3": (435, 435),
    "copy_file_range": (326, 285),
    "fanotify_init": (300, 262),
    "fsopen": (430, 430),
    "getpid": (39, 172),
    "inotify_init1": (294, 26),
    "io_uring_setup": (425, 425),
    "kcmp": (312, 272),
    "kexec_load": (246, 104),
    "keyctl": (250, 219),
    "landlock_create_ruleset": (444, 444),
    "memfd_create": (319, 279),
    "memfd_secret": (447, 447),
    "mincore": (27, 232),
    "mount": (165, 40),
    "move_pages": (279, 239),
    "msgget": (68, 186),
    "name_to_handle_at": (303, 264),
    "open_tree": (428, 428),
    "perf_event_open": (298, 241),
    "personality": (135, 92),
    "pidfd_getfd": (438, 438),
    "pidfd_open": (434, 434),
    "preadv2": (327, 286),
    "process_madvise": (440, 440),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "ptrace": (101, 117),
    "readahead": (187, 213),
    "request_key": (249, 218),
    "sched_setattr": (314, 274),
    "seccomp": (317, 277),
    "semget": (64, 190),
    "sendmsg": (46, 211),
    "set_mempolicy": (238, 237),
    "setns": (308, 268),
    "setxattr": (188, 5),
    "shmget": (29, 194),
    "socket": (41, 198),
    "splice": (275, 76),
    "swapon": (167, 224),
    "sync": (162, 81),
    "sync_file_range": (277, 84),
    "syslog": (103, 116),
    "unshare": (272, 97),
    "userfaultfd": (323, 282),
    "vmsplice": (278, 75),
}
"""Numbers of system calls on x86-64 and on ARM."""

PAGES = bytearray(4 * mmap.PAGESIZE)
SHARED = os.open("/usr/bin/env", os.O_RDONLY)
"""A file that all sandboxes show."""

_KEPT = []
"""Arguments of calls, which must outlive them."""


def call(name, *arguments):
    """The result of a system call. Bytes are passed by their address."""
    number = NUMBERS[name][platform.machine() == "aarch64"]
    passed = [ctypes.c_char_p(one) if isinstance(one, bytes) else ctypes.c_long(one) for one in arguments]
    passed += [ctypes.c_long(0)] * (6 - len(passed))
    result = LIBC.syscall(ctypes.c_long(number), *passed)
    if result == -1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def function(name, *arguments):
    """The result of a function of the C library that sets errno."""
    result = getattr(LIBC, name)(*arguments)
    if result == -1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def address(buffer):
    """The address of a copy in a bytearray, or of a bytearray itself."""
    _KEPT.append(buffer)
    return ctypes.addressof(ctypes.c_char.from_buffer(buffer))


def mapped(file, flags, protection=mmap.PROT_READ | mmap.PROT_WRITE):
    """The address of four pages, mapped by the C library: Python's own mmap calls another one for anonymous pages."""
    LIBC.mmap.restype = ctypes.c_void_p
    LIBC.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long)
    found = LIBC.mmap(None, len(PAGES), protection, flags, file, 0)
    if found == 2**64 - 1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return found


def opened(flags, *roots):
    """The files below folders that can be opened, apart from those of processes."""
    found = []
    for root in roots:
        for folder, folders, names in os.walk(root):
            folders[:] = [one for one in folders if not (folder == "/proc" and (one.isdigit() or one == "thread-self"))]
            for name in names:
                try:
                    os.close(os.open(os.path.join(folder, name), flags | os.O_NONBLOCK))
                    found.append(os.path.join(folder, name))
                except OSError:
                    pass
    return nonzero(found)


def nonzero(found):
    """What was found. Raises OSError if it is nothing."""
    if not found:
        raise OSError("nothing was found")
    return found


def told_by(*names):
    """The files of /proc that say something."""
    found = []
    for name in names:
        try:
            with open(f"/proc/{name}") as file:
                found += [name] if file.read(1) else []
        except OSError:
            pass
    return nonzero(found)


def families(make):
    """The families of sockets for which a function makes one, of any type."""
    found = []
    for family in range(1, 64):
        for kind in (1, 2, 3, 5):
            try:
                os.close(make(family, kind))
                found.append(family)
                break
            except OSError:
                pass
    return nonzero(found)


def socket_pair(family, kind):
    both = (ctypes.c_int * 2)()
    function("socketpair", family, kind, 0, both)
    os.close(both[1])
    return both[0]


def abstract_name():
    with socket.socket(socket.AF_UNIX) as one:
        one.bind("\0crowdbench")
        return one.getsockname()


def passed_file():
    first, _ = socket.socketpair()
    return first.sendmsg([b"x"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [0]))])


def machine_code(code):
    """The exit status of a child that runs machine code."""
    child = os.fork()
    if child == 0:
        place = mmap.mmap(-1, mmap.PAGESIZE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, mmap.PROT_WRITE | mmap.PROT_EXEC)
        place.write(code)
        os._exit(0 if ctypes.CFUNCTYPE(ctypes.c_long)(address(place))() > 0 else 1)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status != 0:
        raise OSError(f"status {status}")
    return "it ran"


def foreign_call():
    if platform.machine() != "x86_64":
        raise OSError("this machine has none")
    return machine_code(b"\xb8\x14\x00\x00\x00\xcd\x80\xc3")  # mov eax, 20 (getpid of i386); int 0x80; ret


def x32_call():
    if platform.machine() != "x86_64":
        raise OSError("this machine has none")
    result = LIBC.syscall(ctypes.c_long(0x40000000 | 39))
    if result == -1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def child_in_namespace(name, *arguments):
    result = call(name, *arguments)
    if result == 0:
        os._exit(0)
    os.waitpid(result, 0)
    return result


def attached_to_parent():
    with open("/proc/1/mem", "r+b", buffering=0) as memory:
        with open("/proc/1/maps") as maps:
            memory.seek(int(maps.readline().split("-")[0], 16))
        return memory.read(4)


def inherited():
    found = []
    for file in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # the list itself is closed
            found.append(os.readlink(f"/proc/self/fd/{file}"))
    return nonzero([file for file in found if "memfd" in file])


def locked():
    with open("/tmp/locked", "w") as file:
        return fcntl.lockf(file, fcntl.LOCK_EX, 1, 5) or "locked"


VECTOR = struct.pack("<QQ", address(PAGES), len(PAGES))
NEW_USER = 0x10000000

ATTACKS = {
    # files and rights
    "write to the kernel's settings (B7)": lambda: os.open("/proc/sys/kernel/core_pattern", os.O_WRONLY),
    "write to any file of the kernel": lambda: opened(os.O_WRONLY, "/proc", "/sys"),
    "read the kernel's settings": lambda: opened(os.O_RDONLY, "/proc/sys"),
    "read about the machine and other processes": lambda: told_by("keys", "kallsyms", "vmstat", "interrupts", "locks"),
    "open files by handles": lambda: call("name_to_handle_at", -100, b"/usr", 0, 0, 0),
    "change the root": lambda: call("chroot", b"/tmp"),
    "write to the sandbox's first process": attached_to_parent,
    # sockets
    "sockets of any family (B8)": lambda: families(lambda family, kind: call("socket", family, kind, 0)),
    "pairs of sockets of other families": lambda: nonzero([one for one in families(socket_pair) if one != 1]),
    "an abstract name": abstract_name,
    "pass a file by a socket": passed_file,
    # what a process before has left in the page cache (B2)
    "posix_fadvise": lambda: os.posix_fadvise(SHARED, 0, 0, os.POSIX_FADV_DONTNEED) or "dropped",
    "mincore": lambda: call("mincore", mapped(SHARED, mmap.MAP_SHARED, mmap.PROT_READ), 4096, address(PAGES)),
    "posix_fadvise, to read ahead": lambda: os.posix_fadvise(SHARED, 0, 0, os.POSIX_FADV_WILLNEED) or "read",
    "cachestat": lambda: call("cachestat", SHARED, address(bytearray(16)), address(bytearray(40)), 0),
    "preadv2, without waiting": lambda: call("preadv2", SHARED, address(bytearray(VECTOR)), 1, 0, 0, 8),
    "os.preadv, without waiting": lambda: os.preadv(SHARED, [PAGES], 0, 8),
    "readahead": lambda: call("readahead", SHARED, 0, 4096),
    "sync_file_range": lambda: call("sync_file_range", SHARED, 0, 0, 2),
    "madvise, to page out": lambda: function(
        "madvise", ctypes.c_void_p(mapped(-1, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)), ctypes.c_size_t(4096), 21
    ),
    "process_madvise": lambda: call("process_madvise", call("pidfd_open", os.getpid()), 0, 0, 20, 0),
    # memory that no process shows to have
    "a file in memory that it inherits": inherited,
    "memfd_create": lambda: os.memfd_create("hoard"),
    "memfd_secret": lambda: call("memfd_secret", 0),
    "System V memory": lambda: call("shmget", 0, 4096, 0o1600),
    "System V messages": lambda: call("msgget", 0, 0o1600),
    "System V semaphores": lambda: call("semget", 0, 1000, 0o1600),
    "shared memory without a file": lambda: mapped(-1, mmap.MAP_SHARED | mmap.MAP_ANONYMOUS),
    "shared memory of /dev/zero": lambda: mapped(os.open("/dev/zero", os.O_RDWR), mmap.MAP_SHARED),
    "huge pages": lambda: mapped(-1, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | 0x40000),
    "larger pipes": lambda: fcntl.fcntl(os.pipe()[1], 1031, 1 << 20),
    "locks on parts of files": locked,
    "a lock on a file of the machine": lambda: fcntl.flock(SHARED, fcntl.LOCK_EX | fcntl.LOCK_NB) or "locked",
    "pages given to a pipe": lambda: call("vmsplice", os.pipe()[1], address(bytearray(VECTOR)), 1, 0),
    "watches of files": lambda: call("inotify_init1", 0),
    "attributes of files": lambda: call("setxattr", b"/tmp", b"user.x", b"value", 5, 0),
    "terminals": lambda: os.openpty(),
    # other processes, and other ways into the kernel
    "io_uring": lambda: call("io_uring_setup", 4, address(bytearray(120))),
    "keyctl": lambda: call("keyctl", 0, -3, 0),
    "add_key": lambda: call("add_key", b"user", b"crowdbench", b"x", 1, -3),
    "request_key": lambda: call("request_key", b"user", b"crowdbench-none", 0, -3),
    "ptrace": lambda: call("ptrace", 0),
    "process_vm_readv": lambda: call(
        "process_vm_readv", os.getpid(), address(bytearray(VECTOR)), 1, address(bytearray(VECTOR)), 1, 0
    ),
    "process_vm_writev": lambda: call(
        "process_vm_writev", os.getpid(), address(bytearray(VECTOR)), 1, address(bytearray(VECTOR)), 1, 0
    ),
    "pidfd_open": lambda: call("pidfd_open", os.getpid(), 0),
    "pidfd_getfd": lambda: call("pidfd_getfd", call("pidfd_open", os.getpid(), 0), 1, 0),
    "kcmp": lambda: call("kcmp", os.getpid(), os.getpid(), 1, 0, 0),
    "userfaultfd": lambda: call("userfaultfd", 1),
    "perf_event_open": lambda: call(
        "perf_event_open", address(bytearray(struct.pack("<IIQ", 1, 128, 0) + bytes(112))), 0, -1, -1, 0
    ),
    "bpf": lambda: call("bpf", 0, address(bytearray(struct.pack("<IIII", 2, 4, 4, 1) + bytes(112))), 128),
    "kexec_load": lambda: call("kexec_load", 0, 0, 0, 0),
    "syslog": lambda: call("syslog", 10, 0, 0),
    "landlock": lambda: call("landlock_create_ruleset", 0, 0, 1),
    "seccomp": lambda: call("seccomp", 2, 0, address(bytearray(struct.pack("<I", 0x7FFF0000)))),
    "fanotify": lambda: call("fanotify_init", 0x200, 0),
    "splice": lambda: call("splice", SHARED, address(bytearray(8)), os.pipe()[1], 0, 1, 0),
    "copy_file_range": lambda: call("copy_file_range", SHARED, 0, os.open("/tmp/copy", 66), 0, 100, 0),
    "move_pages": lambda: call("move_pages", 0, 0, 0, 0, 0, 0),
    "set_mempolicy": lambda: call("set_mempolicy", 0, 0, 0),
    "personality": lambda: call("personality", 0x40000),
    "sync": lambda: call("sync"),
    "be undumpable": lambda: function("prctl", 4, 0, 0, 0, 0),
    "send a core dump to a program of root": lambda: function(
        "setrlimit", 4, ctypes.c_char_p(struct.pack("<QQ", 0, 0))
    ),
    "sched_setaffinity": lambda: os.sched_setaffinity(0, os.sched_getaffinity(0)) or "set",
    "sched_setattr": lambda: os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0)) or "set",
    # namespaces and mounts
    "unshare": lambda: call("unshare", NEW_USER),
    "clone with a namespace": lambda: child_in_namespace("clone", NEW_USER | signal.SIGCHLD),
    "clone with a namespace of mounts": lambda: child_in_namespace("clone", 0x20000 | signal.SIGCHLD),
    "clone3 with a namespace": lambda: child_in_namespace(
        "clone3", address(bytearray(struct.pack("<QQQQQ", NEW_USER, 0, 0, 0, signal.SIGCHLD) + bytes(24))), 64
    ),
    "clone3": lambda: child_in_namespace(
        "clone3", address(bytearray(struct.pack("<QQQQQ", 0, 0, 0, 0, signal.SIGCHLD) + bytes(24))), 64
    ),
    "setns": lambda: call("setns", os.open("/proc/self/ns/uts", os.O_RDONLY), 0),
    "mount": lambda: call("mount", b"none", b"/tmp", b"tmpfs", 0, 0),
    "fsopen": lambda: call("fsopen", b"tmpfs", 0),
    "open_tree": lambda: call("open_tree", -100, b"/tmp", 0),
    # other numbers for the same calls
    "calls of 32 bits": foreign_call,
    "calls of x32": x32_call,
}


def outcomes():
    """What each attack reports, by its name."""
    found = {}
    for name, attack in ATTACKS.items():
        try:
            found[name] = f"worked: {str(attack())[:300]}"
        except BlockingIOError:
            found[name] = "worked: the file is not in the page cache"
        except OSError as error:
            found[name] = f"refused: {error}"
    return found
