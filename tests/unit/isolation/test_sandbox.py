"""What a planner finds in its sandbox: Python, crowdbench and its own files, and no way to anything else."""

import os
import socket
from pathlib import Path

import pytest
from probes import probe

from crowdbench.isolation import sandbox
from crowdbench.isolation.isolated_planner import ResourceLimits
from crowdbench.plugins.kind import ROOT
from crowdbench.utils.errors import InputError

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


def test_it_sees_nothing_but_python_crowdbench_the_system_and_its_own_file(tmp_path):
    (tmp_path / "other.py").write_text("secret")
    facts = probe(
        tmp_path,
        """
        import sys
        def is_known(path):
            return any(path.startswith(known) for known in KNOWN)
        roots = "/proc", "/usr", "/bin", "/sbin", "/lib", "/dev", "/sys/devices/system/cpu", "/etc"
        own = __file__, os.path.join(os.path.dirname(__file__), "__pycache__")
        KNOWN = [*roots, sys.base_prefix, sys.prefix, *CROWDBENCH, *own]
        seen = [os.path.join(folder, name) for folder, _, names in os.walk("/") for name in names]
        return Probe({"other": " ".join(path for path in seen if not is_known(path)), "count": str(len(seen)),
                      "etc": " ".join(sorted(os.listdir("/etc")))})
        """.replace("        ", "").replace("CROWDBENCH", repr(tuple(map(str, sandbox.crowdbench_places())))),
    )
    assert facts["other"] == ""
    assert int(facts["count"]) > 1000
    assert set(facts["etc"].split()) <= {"alternatives", "ld.so.cache", "localtime"}


def test_the_repository_with_its_boards_and_seasons_is_not_there(tmp_path):
    secret = [
        ROOT / ".git",
        ROOT / "leaderboards",
        ROOT / "leaderboards" / "season.toml",
        ROOT / "leaderboards" / "five",
        ROOT / "README.md",
        Path.home() / ".ssh",
    ]
    there = f"[path for path in {list(map(str, secret))} if os.path.exists(path)]"
    facts = probe(tmp_path, f"return Probe({{'there': str({there})}})")
    assert facts["there"] == "[]"


def test_it_has_no_capabilities_and_is_nobody(tmp_path):
    facts = probe(
        tmp_path,
        """
        status = dict(line.split(":\\t", 1) for line in open("/proc/self/status").read().splitlines())
        mount = subprocess.run(["mount", "-o", "remount,rw", "/usr"], capture_output=True).returncode
        return Probe({**{name: status[name] for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")},
                      "user": str(os.getuid()), "mount": str(mount),
                      "namespace": str(ctypes.CDLL(None).unshare(0x10000000))})
        """.replace("        ", ""),
    )
    assert {facts.pop("user")} == {"65534"}
    assert facts.pop("mount") != "0"
    assert facts.pop("namespace") == "-1"
    assert set(facts.values()) == {"0" * 16}


def test_it_writes_nowhere_but_in_its_temporary_folders(tmp_path):
    places = ["/", "/usr", "/dev", "/etc", str(sandbox.crowdbench_places()[0]), *sandbox.TEMPORARY]
    facts = probe(
        tmp_path,
        f"return Probe({{place: tried(lambda: open(place + '/written', 'w').close()) for place in {places}}})",
    )
    assert {place for place, found in facts.items() if found == "None"} == set(sandbox.TEMPORARY)
    assert not any(Path(place, "written").exists() for place in places)


def test_sockets_and_the_network_cannot_be_reached(tmp_path):
    path = f"/tmp/crowdbench-test-{os.getpid()}.sock"  # where the sandbox has a folder of its own
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(socket.AF_UNIX) as local:
        local.bind(path)
        local.listen()
        try:
            body = f"""
return Probe({{
    "network": tried(lambda: socket.create_connection(("127.0.0.1", {server.getsockname()[1]}), 1)),
    "socket": tried(lambda: socket.socket(socket.AF_UNIX).connect({path!r})),
}})
"""
            facts = probe(tmp_path, body)
        finally:
            os.unlink(path)
    assert facts == {"network": "OSError", "socket": "OSError"}


def test_processes_of_a_planner_can_talk(tmp_path):
    body = """
import asyncio, multiprocessing
first, second = multiprocessing.Pipe()
forked(1, lambda: second.send("from a child"))
async def answer():
    await asyncio.sleep(0)
    return "from a loop"
return Probe(pipe=first.recv(), loop=asyncio.run(answer()))
"""
    assert probe(tmp_path, body) == {"pipe": "from a child", "loop": "from a loop"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has files that nobody may read")
def test_root_is_told_which_file_planners_may_not_read(tmp_path):
    table = tmp_path / "tables" / "table.txt"
    table.parent.mkdir()
    table.write_text("three")
    table.chmod(0o600)
    with pytest.raises(
        InputError, match=r"table.txt cannot be read by planners, since root runs them as the user nobody"
    ):
        probe(tmp_path, "return Probe()", file=str(table))


def test_files_and_folders_that_options_name_are_shown(tmp_path):
    table = tmp_path / "tables" / "table.txt"
    table.parent.mkdir()
    table.write_text("three")
    for named, opened in ((table, "file"), (table.parent, "file + '/table.txt'")):
        assert probe(tmp_path, f"return Probe({{'text': open({opened}).read()}})", file=str(named)) == {"text": "three"}


def test_temporary_files_count_as_memory(tmp_path):
    body = "open('/tmp/large', 'wb').write(bytes(700_000_000))\nimport time\ntime.sleep(5)\nreturn Probe({})"
    with pytest.raises(InputError, match=r"took \d\.\d GB of memory, more than 0\.6 GB, in its construction"):
        probe(tmp_path, body, ResourceLimits(memory=6e8))


def test_a_temporary_folder_holds_no_more_than_its_limit(tmp_path):
    body = f"return Probe({{'large': tried(lambda: os.posix_fallocate(os.open('/tmp/large', 65), 0, {2 * 10**9}))}})"
    assert probe(tmp_path, body) == {"large": "OSError"}


def test_secrets_in_the_environment_are_not_passed_on(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET_TOKEN", "secret")
    assert "SECRET_TOKEN" not in probe(tmp_path, "return Probe({'names': ' '.join(os.environ)})")["names"]
