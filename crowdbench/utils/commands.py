"""Commands that users are told to run next, quoted so that a shell runs them as printed."""

from __future__ import annotations

import shlex


def command(*words: object) -> str:
    """Return a command of crowdbench with these words, such as `score` and a path."""
    return shlex.join(["crowdbench", *map(str, words)])
