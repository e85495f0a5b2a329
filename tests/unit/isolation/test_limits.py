"""Programs that take more than they may: each ends within a tenth of its limit, and what only looks large does not."""

import os
import shutil
import sys
import time
from pathlib import Path

import pytest
from probes import made

from crowdbench.isolation import limits, sandbox
from crowdbench.isolation.isolated_planner import ResourceLimits
from crowdbench.utils.errors import InputError

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


@pytest.fixture(params=["group", "no group"])
def _groups(request, monkeypatch):
    """With a control group where one can be made, and without."""
    if request.param == "group":
        if limits._home() is None:
            pytest.skip("no group of cgroup v2 can be made here")
    else:
        monkeypatch.setattr(limits, "_home", lambda: None)


HOARDS = {
    "in itself": "hoard = []\nwhile True:\n    hoard.append(np.ones(2_000_000))",
    "in a file": "file = open('/tmp/a', 'wb')\nwhile True:\n    file.write(bytes(10_000_000))\n    file.flush()",
    "in a file without a name": (
        "file = os.open('/dev/shm', os.O_TMPFILE | os.O_RDWR)\nwhile True:\n    os.write(file, bytes(10_000_000))"
    ),
    "in page tables": (  # of 4 kB for each byte that is read, although no memory is written
        "empty = mmap.mmap(-1, 2**41, flags=0x4022, prot=mmap.PROT_READ)\n"
        "for place in range(0, 2**41, 2**21):\n    empty[place]\ntime.sleep(99)"
    ),
    "in sockets": "pairs = [socket.socketpair() for _ in range(500)]\ntime.sleep(99)",
    "in children": "forked(5, lambda: (np.ones(12_500_000), time.sleep(99)))\ntime.sleep(99)",
    "in children whose parent has ended": (
        "forked(1, lambda: forked(5, lambda: (os.setsid(), np.ones(12_500_000), time.sleep(99))))\ntime.sleep(99)"
    ),
}


@pytest.mark.parametrize("where", HOARDS)
@pytest.mark.usefixtures("_groups")
def test_memory_is_counted_wherever_it_lies(where, tmp_path):
    with (
        pytest.raises(InputError, match=r"took 0\.\d GB of memory, more than 0\.4 GB") as error,
        made(tmp_path, HOARDS[where], ResourceLimits(memory=4e8)),
    ):
        pytest.fail("it took too much")
    taken = float(str(error.value).split(" took ")[1].split()[0])
    assert 0.4 <= taken <= 0.8  # memory is counted several times per second, on a busy machine less often


HIDDEN = {
    "memfd": "os.memfd_create('hoard')",
    "shared memory without a file": "mmap.mmap(-1, 4096)",
    "System V": "ctypes.CDLL(None).shmget(0, 4096, 0o1600)",
}


@pytest.mark.parametrize("how", HIDDEN)
def test_memory_that_no_process_shows_to_have_cannot_be_made(how, tmp_path):
    with made(tmp_path, f"return Probe(made=tried(lambda: {HIDDEN[how]}))") as planner:
        assert planner.facts["made"] in ("OSError", "-1")


def test_a_file_in_memory_without_a_name_counts_for_a_process_without_a_sandbox(monkeypatch, tmp_path):
    monkeypatch.setattr(sandbox, "level", lambda: sandbox.PROCESS)
    body = "file = os.memfd_create('hoard')\nwhile True:\n    os.write(file, bytes(10_000_000))"
    with (
        pytest.raises(InputError, match=r"took 0\.\d GB of memory, more than 0\.4 GB"),
        made(tmp_path, body, ResourceLimits(memory=4e8)),
    ):
        pytest.fail("it took too much")


@pytest.mark.usefixtures("_groups")
def test_idle_children_take_what_they_do_not_share(tmp_path):
    with made(
        tmp_path, "forked(100, lambda: time.sleep(99))\ntime.sleep(1)\nreturn Probe()", ResourceLimits(memory=1e9)
    ) as one:
        assert one.process.usage.memory < 5e8


@pytest.mark.nightly
@pytest.mark.usefixtures("_groups")
def test_processes_are_limited(tmp_path):
    body = "while True:\n    forked(1, lambda: time.sleep(99))"
    start = time.monotonic()
    with (
        pytest.raises(InputError, match=r"started more than 512 processes and threads|raised BlockingIOError"),
        made(tmp_path, body),
    ):
        pytest.fail("it started too many")
    assert time.monotonic() - start < 60.0


def test_threads_count_as_processes_do(tmp_path):
    body = "while True:\n    threading.Thread(target=time.sleep, args=(99,), daemon=True).start()"
    sentence = r"started more than 512 processes and threads|can't start new thread"
    with pytest.raises(InputError, match=sentence), made(tmp_path, body):
        pytest.fail("it started too many")


def test_empty_files_are_limited_and_count(tmp_path):
    makes = "for number in range(COUNT):\n    os.close(os.open(f'/dev/shm/{number}', os.O_CREAT))\n"
    with made(tmp_path, makes.replace("COUNT", "40_000") + "time.sleep(0.5)\nreturn Probe()") as planner:
        assert planner.process.usage.memory > 4e7
    with (
        pytest.raises(InputError, match="made more than 50000 files"),
        made(tmp_path, makes.replace("COUNT", "10 ** 9")),
    ):
        pytest.fail("it made too many")


BUSY = "(time.sleep(0.01), [0 for _ in iter(int, 1)])"


@pytest.mark.usefixtures("_groups")
@pytest.mark.parametrize("body", [f"forked(6, lambda: {BUSY})\ntime.sleep(99)", "while True:\n    pass"])
def test_busy_children_share_the_time_of_their_planner(body, tmp_path):
    cores = limits.usable_cores()[:1]
    before = os.times()
    with (
        pytest.raises(InputError, match="took longer than 3 s in its construction"),
        made(tmp_path, body, ResourceLimits(construction=3.0), cores=cores),
    ):
        pytest.fail("it took too long")
    after = os.times()
    assert after.children_user + after.children_system - before.children_user - before.children_system < 4.0


SHORT_LIVED = """
signal.signal(signal.SIGCHLD, signal.SIG_DFL)
def work():
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
for _ in range(5):
    forked(1, work)
    os.wait()
return Probe()
"""


@pytest.mark.usefixtures("_groups")
def test_the_time_of_children_that_have_ended_counts(tmp_path):
    with made(tmp_path, SHORT_LIVED) as planner:
        assert planner.process.usage.seconds() > 1.0


def test_the_time_of_children_that_nobody_waits_for_counts_in_a_group(tmp_path):
    if limits._home() is None:
        pytest.skip("no group of cgroup v2 can be made here")
    body = SHORT_LIVED.replace("SIG_DFL", "SIG_IGN").replace("os.wait()", "time.sleep(0.5)")
    with made(tmp_path, body) as planner:
        assert planner.process.usage.seconds() > 1.0


def test_a_planner_stays_on_its_processor(tmp_path):
    core = limits.usable_cores()[-1:]
    body = (
        "return Probe(moved=tried(lambda: os.sched_setaffinity(0, range(64))), on=str(sorted(os.sched_getaffinity(0))))"
    )
    with made(tmp_path, body, cores=core) as planner:
        assert planner.facts == {"moved": "OSError", "on": str(core)}


def test_control_groups_are_removed(tmp_path):
    home = limits._home()
    if home is None:
        pytest.skip("no group of cgroup v2 can be made here")
    with made(tmp_path, "forked(3, lambda: time.sleep(99))\nreturn Probe()") as planner:
        group = planner.process.usage._group
        assert group.is_dir()
    assert not group.exists()


@pytest.mark.skipif(
    limits._home() is None or not limits._limits(limits._home()),
    reason="no group of cgroup v2 with the controllers memory and pids is delegated here",
)
def test_a_delegated_group_limits_memory_and_processes(tmp_path):
    assert limits.describe_limits() == "memory and processes by cgroup v2, and time by cgroup v2"
    with made(tmp_path, "return Probe()", ResourceLimits(memory=1e9)) as planner:
        usage = planner.process.usage
        assert (int(usage._read("memory.max")) // 4096, int(usage._read("pids.max"))) == (10**9 // 4096, 512)


FORGED = """
print('::error::forged', flush=True)
sys.stderr.write('##[error]forged\\n\\x1b[2J\\u202eadet careful on five: passes, re-run\\n')
os.write(2, b'no end' * 20_000)
return Probe()
"""


def test_what_a_planner_prints_is_harmless(tmp_path, capfd):
    with made(tmp_path, FORGED):
        pass
    shown = capfd.readouterr()
    assert shown.out == ""
    lines = shown.err.splitlines()
    assert lines[0] == "planner probe: : :error: :forged"
    assert lines[1:3] == [
        "planner probe: ## [error]forged",
        "planner probe: \\x1b[2J\\xe2\\x80\\xaeadet careful on five: passes, re-run",
    ]
    assert len(shown.err) < 30_000


def test_what_a_planner_says_of_its_failure_is_harmless(tmp_path):
    body = "from crowdbench.utils.errors import InputError\nraise InputError('::add-mask::a ##[error]')"
    with pytest.raises(InputError) as error, made(tmp_path, body):
        pytest.fail("it cannot be made")
    assert "::" not in str(error.value)
    assert "##[" not in str(error.value)


def test_a_checkout_in_a_folder_of_python_is_hidden(tmp_path):
    place = Path(sys.prefix) / "lib" / f"crowdbench-test-{os.getpid()}"
    (place / "five" / "entries").mkdir(parents=True)
    (place / "secret.toml").write_text("secret")
    try:
        body = f"return Probe(secret=open({str(place / 'secret.toml')!r}).read())"
        with pytest.raises(InputError, match="FileNotFoundError"), made(tmp_path, body, hidden=[place]):
            pytest.fail("it was read")
        with made(tmp_path, f"return Probe(all=str(os.listdir({str(place)!r})))", hidden=[place]) as planner:
            assert planner.facts["all"] == "[]"
    finally:
        shutil.rmtree(place)
