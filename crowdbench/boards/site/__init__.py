"""The pages of the leaderboards: plain files that need no server, no network and no JavaScript."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection
from pathlib import Path

from crowdbench.utils.errors import InputError


def build_site(root: Path, out: Path, names: Collection[str] = ()) -> int:
    """Build the pages of boards.

    The same boards give the same bytes, apart from recordings (`.rrd`), in which Rerun numbers its chunks at random.

    Args:
        root: The folder of boards.
        out: The folder of the pages. One that an earlier build has made is replaced.
        names: The names of the boards; all if there are none.

    Returns:
        The number of pages.

    Raises:
        InputError: Jinja2 or Matplotlib is missing, there is no such board, a board or an entry is not as it must be,
            or `out` holds something else or cannot be written.
    """
    if missing := [name for name in ("jinja2", "matplotlib") if importlib.util.find_spec(name) is None]:
        raise InputError(
            f"the pages need {' and '.join(missing)}, which is not installed: pip install 'crowdbench[site]'"
        )
    from crowdbench.boards.site.build import build

    return build(root, out, names)
