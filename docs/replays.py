"""The replay of the scenarios of the suite, to which the site links: case val/0 of each with two planners."""

import functools
import re
import tempfile
from pathlib import Path

import noticing_page

from crowdbench.catalog import load_scenario
from crowdbench.export.replay_page import export_page
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.utils.progress_bars import progress

FOLDER = "replay"
"""The folder of the replay in the site."""

PLANNERS = (noticing_page.PLANNER, "mppi")

LINKING = ("noticing", "suite")
"""The pages with links to the replay."""


@functools.cache
def files() -> dict[str, bytes]:
    """Run the cases, and return the files of their replay by address."""
    names = noticing_page.suite_names()
    with tempfile.TemporaryDirectory() as place, progress(len(names) * len(PLANNERS), "of the replay") as report:
        runs = []
        for name in names:
            for planner in PLANNERS:
                folder = Path(place) / planner / name
                make_run(load_run(RunSpec(planner, name, noticing_page.CASE, record="all")), folder)
                runs.append(RunResult.read(folder))
                report(1)
        page = Path(place) / FOLDER
        page.mkdir()
        export_page(runs, lambda run: load_scenario(run.directory.name), page, back=("../suite.html", "The suite"))
        return {path.relative_to(place).as_posix(): path.read_bytes() for path in sorted(page.rglob("*.*"))}


def add_links(markdown: str) -> str:
    """Link the picture of each scenario, and each name in the first column of a table, to the case in the replay."""
    names = re.compile(f"`({'|'.join(noticing_page.suite_names())})`")
    lines = []
    for line in markdown.splitlines():
        cell = re.match(r"\| `[^|]*", line)
        if cell:
            line = names.sub(lambda name: f"[{name[0]}]({link(name[1])})", cell[0]) + line[cell.end() :]
        lines.append(line)
        if picture := re.match(r"( *)!\[.*\]\(noticing/(\w+)\.svg\)", line):
            lines += ["", f"{picture[1]}[Watch the case]({link(picture[2])})"]
    return "\n".join(lines)


def link(scenario: str) -> str:
    """Return the address of the case of a scenario in the replay."""
    case = noticing_page.CASE
    return f"{FOLDER}/index.html#{scenario}/{case.split}/{case.start}/{','.join(PLANNERS)}"
