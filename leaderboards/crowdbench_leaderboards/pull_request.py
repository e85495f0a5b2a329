"""Checks that a pull request changes only entries of its author: python pull_request.py BASE AUTHOR.

The entries of an author are those whose card names the author's GitHub account (`account`), before the change and after
it. BASE is the commit that the pull request is to be merged into. Prints the folders of the entries that exist
after the change, for `crowdbench verify`. It needs only Python and git. The script of BASE is run.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib

PATH = re.compile(
    r"(leaderboards/[a-z0-9_]+)(/entries/[a-z0-9][a-z0-9_]{1,49})"
    r"/((?:entry\.json|card\.toml|public\.parquet|planner(?:/[A-Za-z0-9_][A-Za-z0-9_.+-]*)+)"
    r"|(?P<signed>season\.parquet|verdict\.json))",
    re.ASCII,
)
"""The files of entries. Verdicts are written by maintainers alone, and go only with their entry."""

ACCOUNT = re.compile("[a-z0-9](-?[a-z0-9]){0,38}", re.ASCII)
"""The logins of the forge, in lower case."""

PLAIN = {"000000", "100644", "100755"}
"""The modes of files, and of missing files; all others are links and other repositories."""


def git(*arguments: str) -> str:
    """Return the output of git. Raises CalledProcessError if it fails."""
    return subprocess.run(
        ["git", *arguments], check=True, capture_output=True, text=True, errors="surrogateescape"
    ).stdout


def is_there(commit: str, path: str) -> bool:
    """Return whether a commit has a file or a folder, with exactly this name."""
    return bool(git("ls-tree", "-z", "--name-only", commit, path))


def owner(commit: str, folder: str) -> str:
    """Return the account of the owner of an entry in a commit; empty if the card has none."""
    try:
        account = tomllib.loads(git("show", f"{commit}:{folder}/card.toml")).get("account")
    except (subprocess.CalledProcessError, ValueError):
        return ""
    return account if isinstance(account, str) and ACCOUNT.fullmatch(account) else ""


def changed_entries(base: str, author: str) -> list[str]:
    """Return the folders of the changed entries that exist in HEAD. Raises ValueError if the change is not allowed."""
    fields = git("diff", "--raw", "-z", "--no-renames", "--abbrev=40", f"{base}...HEAD").split("\0")
    folders, signed = set(), []
    for change, path in zip(fields[::2], fields[1::2], strict=False):
        match = PATH.fullmatch(path)
        if not match or not is_there(base, f"{match[1]}/board.toml"):
            raise ValueError(f"{path!a} is not a file of an entry, and only entries may change")
        if change.split()[1] not in PLAIN:
            raise ValueError(f"{path!a} is not a plain file")
        folders.add(match[1] + match[2])
        signed += [(match[1] + match[2], path)] * bool(match["signed"])
    for folder in sorted(folders):
        for commit in (base, "HEAD"):
            if is_there(commit, folder) and owner(commit, folder) != author.lower():
                whose = owner(commit, folder) or "nobody: its card must have the login as account, in lower case"
                raise ValueError(f"{folder} is not an entry of {author}: it belongs to {whose!a}")
    for folder, path in signed:
        if is_there("HEAD", folder):
            raise ValueError(f"{path!a} is a verdict: only maintainers write it, and it goes only with its entry")
    return [folder for folder in sorted(folders) if is_there("HEAD", folder)]


if __name__ == "__main__":
    try:
        found = changed_entries(*sys.argv[1:])
    except ValueError as error:
        sys.exit(str(error))
    for each in found:
        print(each)
