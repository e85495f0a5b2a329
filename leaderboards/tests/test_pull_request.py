"""A pull request changes the entries of its author, and nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "crowdbench_leaderboards" / "pull_request.py"
WORKFLOW = Path(__file__).parents[2] / ".github" / "workflows" / "entries.yml"


class Clone:
    """A repository with two entries, and a branch that changes something."""

    def __init__(self, folder):
        self.folder = folder
        self.git("init", "-q", "-b", "main")
        for name, account in (("hers", "ada"), ("his", "bob"), ("nobodys", ""), ("upper", "Ada")):
            self.write(f"leaderboards/five/entries/{name}/card.toml", f'account = "{account}"\n')
            self.write(f"leaderboards/five/entries/{name}/entry.json", "{}")
        self.write("leaderboards/five/board.toml", "")
        self.write("crowdbench/code.py", "")
        self.commit()
        self.base = self.git("rev-parse", "HEAD").strip()
        self.git("checkout", "-q", "-b", "change")

    def git(self, *arguments):
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "core.quotePath=true")
        return subprocess.run(
            ["git", *who, *arguments], cwd=self.folder, check=True, capture_output=True, text=True
        ).stdout

    def write(self, path, text=""):
        (self.folder / path).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / path).write_text(text)

    def commit(self):
        self.git("add", "-A")
        self.git("commit", "-q", "-m", "a")

    def check(self, author="ada"):
        self.commit()
        return subprocess.run(
            [sys.executable, SCRIPT, self.base, author], cwd=self.folder, capture_output=True, text=True
        )


@pytest.fixture
def clone(tmp_path):
    return Clone(tmp_path)


def entry(name):
    return f"leaderboards/five/entries/{name}"


def test_a_new_entry_and_ones_own_may_change_and_go(clone):
    clone.write(f"{entry('hers')}/planner/mine.py")
    clone.write(f"{entry('new')}/card.toml", 'account = "ada"')
    done = clone.check()
    assert (done.returncode, done.stdout.split()) == (0, [entry("hers"), entry("new")])
    clone.write(f"{entry('hers')}/verdict.json", "{}")
    clone.commit()
    clone.git("rm", "-r", "-q", entry("hers"))  # with its verdict
    clone.write("leaderboards/five/entries/new/entry.json")
    assert clone.check().stdout.split() == [entry("new")]


def delete(clone):
    clone.git("rm", "-r", "-q", entry("his"))


def delete_in_part(clone):
    clone.git("rm", "-q", f"{entry('his')}/entry.json")


def change(clone):
    clone.write(f"{entry('his')}/entry.json", "{ }")


def take_over(clone):
    clone.write(f"{entry('his')}/card.toml", 'account = "ada"\n')


def rename(clone):
    clone.git("mv", entry("his"), entry("ours"))
    clone.write(f"{entry('ours')}/card.toml", 'account = "ada"\n')


def replace_by_ones_own(clone):
    clone.git("rm", "-r", "-q", entry("his"))
    clone.git("mv", entry("hers"), entry("his"))


def add_to(clone):
    clone.write(f"{entry('his')}/planner/__pycache__/a.pyc")


def change_nobodys(clone):
    clone.write(f"{entry('nobodys')}/entry.json", "{ }")


def enter_for_another(clone):
    clone.write(f"{entry('new')}/card.toml", 'account = "bob"')


def enter_for_nobody(clone):
    clone.write(f"{entry('new')}/card.toml", 'title = "new"')


def enter_without_a_card(clone):
    clone.write(f"{entry('new')}/entry.json", "{}")


def enter_with_a_damaged_card(clone):
    clone.write(f"{entry('new')}/card.toml", "account = [")


def link(clone):
    (clone.folder / entry("hers") / "link.py").symlink_to("card.toml")


def link_a_folder(clone):
    os.symlink("his", clone.folder / entry("other"))


def nest_a_repository(clone):
    inner = clone.folder / entry("hers") / "planner"
    inner.mkdir()
    subprocess.run(["git", "init", "-q"], cwd=inner, check=True)
    (inner / "a").write_text("")
    subprocess.run(["git", "add", "a"], cwd=inner, check=True)
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run(["git", *who, "commit", "-q", "-m", "a"], cwd=inner, check=True)


def change_code(clone):
    clone.write("crowdbench/code.py", "cheat")


def change_rules(clone):
    clone.write("leaderboards/five/board.toml", "cases = 1")


def add_a_verification(clone):
    clone.write(f"{entry('hers')}/verdict.json", "{}")


def change_a_verification(clone):
    clone.git("checkout", "-q", "main")
    clone.write(f"{entry('hers')}/season.parquet", "signed")
    clone.commit()
    clone.base = clone.git("rev-parse", "HEAD").strip()
    clone.git("checkout", "-q", "-b", "other")
    clone.git("rm", "-q", f"{entry('hers')}/season.parquet")


def take_an_account_in_capitals(clone):
    clone.write(f"{entry('upper')}/entry.json", "{ }")


def enter_with_a_line_break_in_the_account(clone):
    clone.write(f"{entry('new')}/card.toml", 'account = "ada\\n"')


def add_another_file(clone):
    clone.write(f"{entry('hers')}/notes.md", "")


def add_a_name_with_a_line_break(clone):
    clone.write(f"{entry('hers')}/planner/a\nb.py", "")


def add_a_board(clone):
    clone.write("leaderboards/six/entries/hers/card.toml", 'account = "ada"')


def change_the_workflow(clone):
    clone.write(".github/workflows/entries.yml", "")


def look_like_his(clone):
    clone.write(f"{entry('His')}/card.toml", 'account = "ada"')


FORBIDDEN = [
    delete, delete_in_part, change, take_over, rename, replace_by_ones_own, add_to, change_nobodys, enter_for_another,
    enter_for_nobody, enter_without_a_card, enter_with_a_damaged_card, link, link_a_folder, nest_a_repository,
    change_code, change_rules, add_a_verification, change_a_verification, take_an_account_in_capitals,
    enter_with_a_line_break_in_the_account, add_another_file, add_a_name_with_a_line_break,
    add_a_board, change_the_workflow, look_like_his,
]  # fmt: skip


@pytest.mark.parametrize("do", FORBIDDEN)
def test_what_is_not_the_authors_does_not_change(do, clone):
    do(clone)
    done = clone.check()
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr


def test_an_author_whose_entry_was_added_to_the_base_meanwhile_changes_it_not(clone):
    clone.write(f"{entry('new')}/card.toml", 'account = "ada"')
    clone.commit()
    clone.git("checkout", "-q", "main")
    clone.write(f"{entry('new')}/card.toml", 'account = "bob"')
    clone.commit()
    clone.base = clone.git("rev-parse", "HEAD").strip()
    clone.git("checkout", "-q", "change")
    clone.write(f"{entry('new')}/entry.json")
    assert "is not an entry of ada: it belongs to 'bob'" in clone.check().stderr


def test_the_workflow_runs_the_check_of_the_base():
    text = WORKFLOW.read_text()
    assert 'git show "$BASE:leaderboards/crowdbench_leaderboards/pull_request.py"' in text
    assert "github.event.pull_request.user.login" in text
    assert "::stop-commands::" in text
