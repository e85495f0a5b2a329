"""The commands submit and verify: what a newcomer does, and what nobody should give."""

import json
import re
from pathlib import Path

import pytest
from commands.test_fuzz import FIELDS, answer, edit_json, fuzz
from commands.test_newcomer import export
from hypothesis import given
from repository.test_docs_commands import CALLS, check_command

from crowdbench.cli import app as cli
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.entry import read_entry


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_command_that_is_not_installed_says_how_to_install_it(call, monkeypatch):
    monkeypatch.setattr(cli, "entry_points", lambda group: [])
    done = call("submit", "orca", "--board", "five")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "crowdbench: the command submit is not installed: in a clone of crowdbench, pip install ./leaderboards\n"
    )


def test_the_commands_are_in_the_help(call):
    assert re.search(r" Boards .*\n. submit .*\n.*\n. verify ", call("--help").stdout)


SHOWN = [(page, arguments) for page, arguments in CALLS if arguments[0] in cli.ELSEWHERE]


@pytest.mark.parametrize(
    ("page", "arguments"), SHOWN, ids=lambda each: each if isinstance(each, str) else " ".join(each)
)
def test_every_command_that_is_shown_is_one(page, arguments):
    check_command(cli.app, page, arguments)


@pytest.mark.parametrize("command", [["verify"], ["submit", "--board", "ten"]], ids=" ".join)
def test_links_in_a_loop_end_in_a_sentence(call, command):
    Path("loop").symlink_to("loop")
    done = call(*command, "loop")
    assert (done.returncode, done.stdout) == (1, "")
    assert "crowdbench itself" not in done.stderr


def test_an_onnx_file_is_ready_for_a_board(call):
    export("policy.onnx")
    assert call("new-planner", "swift_heron").returncode == 0
    card = Path("swift_heron/card.toml")
    answers = {"Your Name": "Ada Lovelace", "you@": "ada@", "slowly where a pedestrian is near": "never waits"}
    answers |= {'account = ""': 'account = "ada"'}
    for asked, given_text in answers.items():
        card.write_text(card.read_text().replace(asked, given_text))
    finished = call("submit", "policy.onnx", "--board", "five", "--card", str(card), "--dry-run")
    assert finished.returncode == 0, finished.stderr
    assert re.search(r"no entry made; 50 public cases will take about \d+ s here", finished.stderr)
    assert not Path("leaderboards").exists()


def test_a_planner_that_is_not_there_or_ends_its_check_gets_a_sentence(call):
    assert call("new-planner", "swift_heron").returncode == 0
    card = Path("swift_heron/card.toml")
    text = (
        card.read_text()
        .replace("Your Name", "Ada")
        .replace("you@", "ada@")
        .replace("slowly", "fast")
        .replace('account = ""', 'account = "ada"')
    )
    card.write_text(text)
    done = call("submit", "nothing.py", "--board", "five", "--card", str(card))
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("crowdbench: there is no file")
    assert "breaks its contract" not in done.stderr
    planner = Path("swift_heron/swift_heron.py")
    planner.write_text(
        planner.read_text() + "\n\nif 'check' in __import__('sys').argv:\n    __import__('os')._exit(7)\n"
    )
    done = call("submit", str(planner), "--board", "five")
    assert done.returncode == 1
    assert done.stderr.endswith(f"crowdbench: planner {planner} ended the process of its check, with status 7\n")


@pytest.fixture(scope="module")
def damaged(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


ENTRY = {
    "format": 2,
    "board": "five",
    "board_digest": "0" * 64,
    "planner": "planner/mine.py",
    "options": {"pace": 0.5, "weights": "planner/a.json"},
    "networks": [],
    "facts": {"circle_crossing_5": {"weights": "1"}},
    "privileged": False,
    "raw": False,
    "environment": {"numpy": "2.0"},
    "files": "0" * 64,
}


@fuzz
@given(FIELDS)
def test_damaged_entries_get_one_sentence(damaged, edits):
    folder = damaged
    (folder / "entry").mkdir(exist_ok=True)
    table = edit_json(json.loads(json.dumps(ENTRY)), edits)
    (folder / "entry" / "entry.json").write_text(json.dumps(table))
    with pytest.raises(InputError):  # there are no files
        read_entry(folder / "entry")
    answer("verify", folder / "entry")
