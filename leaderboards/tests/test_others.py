"""Networks of others: listed by the maintainers, exempt from the rule of two entries, without their weights."""

import functools
import shutil
import subprocess
from pathlib import Path

import pytest
from board_entries import seal
from small_boards import BASELINE, card, write_board
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.isolation import sandbox
from crowdbench.plugins import read_files
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_boards
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.entry import PUBLIC, SEASON_TABLE, VERDICT, read_card, read_entry
from crowdbench_leaderboards.fill import to_submit
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.planner_files import external_files
from crowdbench_leaderboards.season import freeze
from crowdbench_leaderboards.shipped import read_shipped
from crowdbench_leaderboards.verification import Verifier

ROOT = Path(__file__).parents[1]
NAME = "cadrl_circle_orca"
SHIPPED = """
[[shipped]]
name = "{name}"
planner = "cadrl"
options = {{weights = "sha256:{digest}"}}
others = true
"""
needs_sandbox = pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap")


def test_the_listed_networks_of_others_are_at_most_six_and_name_their_source():
    others = [each for each in read_shipped(ROOT).values() if each.others]
    assert 0 < len(others) <= 6
    boards = {board.name for board in read_boards()}
    for each in others:
        about = read_card(ROOT / "cards" / f"{each.name}.toml")
        assert each.options == {"weights": f"sha256:{about.weights_sha256}"}
        assert all([about.authors, about.paper, about.code, about.commit])
        assert about.account == ""
        assert set(each.only_on) <= boards


def test_full_boards_have_fewer_than_1200_files():
    own = {"entry.json", "card.toml", PUBLIC, SEASON_TABLE, VERDICT}
    number = 0
    for board in read_boards():
        for each in read_shipped(ROOT).values():
            copied = read_files(ROOT.parent / each.planner) if "/" in each.planner else []
            number += each.is_on(board.name) * (len(own) + len(copied))
    command = ["git", "ls-files", "--", ".", ":!*/entries/*", ":!frozen.json"]
    others = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert 900 < number + len([*others, "frozen.json"]) < 1200


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[[shipped]]\nname = "a"\nplanner = "cadrl"\nothers = true\n', "a must have others = true and an option"),
        (
            "".join(SHIPPED.format(name=f"a{k}", digest="0" * 64) for k in range(7)),
            "lists 7 planners of others",
        ),
    ],
)
def test_a_wrong_list_gets_one_sentence(text, sentence, tmp_path):
    (tmp_path / "shipped.toml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_shipped(tmp_path)


@pytest.fixture
def listed(shared, tmp_path):
    """A setting of a board whose `shipped.toml` lists a network of others, and the file of its weights."""
    weights = tmp_path / "weights" / f"{NAME}.safetensors"
    weights.parent.mkdir()
    source = shared / "networks" / "circular_crossing__cadrl_on_orca"
    for suffix in (".safetensors", ".json"):
        shutil.copy(source.with_suffix(suffix), weights.with_suffix(suffix))
    root = tmp_path / "boards"
    write_board(root)
    (name,) = external_files([weights])
    (root / "shipped.toml").write_text(SHIPPED.format(name=NAME, digest=name.removeprefix("sha256:")))
    (root / "cards").mkdir()
    text = BASELINE.replace('"ORCA"', '"CADRL of others"') + f'weights_sha256 = "{name[7:]}"\n'
    (root / "cards" / f"{NAME}.toml").write_text(text)
    return functools.partial(Verifier, read_boards(root)[0], root, tmp_path / "work"), weights


@needs_sandbox
@pytest.mark.slow
def test_a_network_of_others_is_entered_and_verified_with_its_file_alone(listed, tmp_path):
    make, weights = listed
    assert to_submit(make({})) == []  # its weights are not given
    setting = make(external_files([weights]))
    (job,) = to_submit(setting)
    job.do(progress=lambda done: None)
    folder = setting.root / "small" / "entries" / NAME
    assert sorted(path.name for path in folder.iterdir()) == ["card.toml", "entry.json", "public.parquet"]
    with pytest.raises(
        InputError, match=r"the entry needs a file that is not in it, sha256:[0-9a-f]{64}: give it, --file"
    ):
        make({}).verify(read_entry(folder))
    other = tmp_path / "other.safetensors"
    other.write_bytes(weights.read_bytes() + b" ")
    done = CliRunner().invoke(app, ["verify", str(folder), "--cases", "3", "--file", str(other)])
    assert "needs a file that is not in it" in str(done.exception)
    done = CliRunner().invoke(app, ["verify", str(folder), "--cases", "3", "--file", str(weights)])
    assert f"{NAME} on small: passes, re-run" in done.output
    found = standings(setting.board, read_entries(setting.board, setting.root), None)
    assert [(one.submitter, one.is_baseline) for one in found.entries] == [("others'", True)]


def test_nobody_else_enters_without_the_files_of_the_planner(root):
    folder = root / "small" / "entries" / "careful"

    seal(folder, options={"weights": "sha256:" + "0" * 64})
    assert "names a file that is not in it" in read_entries(read_boards(root)[0], root).bad["careful"]


def test_planners_of_maintainers_are_exempt_from_the_rule_of_two(root):
    names = ["straight", "social_force", "brne"]
    (root / "shipped.toml").write_text("".join(f'[[shipped]]\nname = "{each}"\nplanner = "orca"\n' for each in names))
    (root / "frozen.json").unlink()
    for each in names:
        shutil.copytree(root / "small" / "entries" / "orca", root / "small" / "entries" / each)
    shutil.rmtree(root / "small" / "entries" / "orca")
    board = read_boards(root)[0]
    for each in names:
        (root / "small" / "entries" / each / "card.toml").write_text(card(account='""', title=f'"{each}"'))

        seal(root / "small" / "entries" / each)
    frozen = freeze(root, "small", read_entries(board, root).good).frozen["small"]
    assert all(frozen[each].ranked for each in names)
