"""Every command that the README and the documentation show is run, on few cases; every study and Python block too."""

import importlib
import re
import shlex
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from crowdbench.cli.app import COMMANDS, ELSEWHERE, app, build_script
from crowdbench.record import viewer
from studies.run import page

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted(ROOT.glob("adapters/*/README.md")),
    *(path for path in sorted(ROOT.glob("studies/*/*.md")) if path.name != "preregistration.md"),  # it stays as it was
]
"""Of docs/, without what is generated from the code; the site has that too."""

RUN_ELSEWHERE = {
    "suite": "tests/commands/test_suite.py",
    "cross": "tests/commands/test_several_vehicles.py",
    "submit": ".ci/boards",
    "verify": ".ci/boards",
    "merge": "tests/commands/test_parts.py",
    "train": ".ci/train",
}
"""Commands that take long, or need what others have left, and where they are run."""


def lines(page):
    """The lines of the blocks marked sh, without comments, joined where they go on."""
    for block in re.findall(r"^```sh\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
        for line in re.sub(r"\\\n\s*", "", block).splitlines():
            yield re.sub(r"\s+#.*", "", line.strip())


def commands(page):
    """The arguments of each call of crowdbench in the blocks of a page."""
    return [shlex.split(line)[1:] for line in lines(page) if line.startswith("crowdbench ")]


def inline(page):
    """The arguments of each call of crowdbench within the text of a page, if it is a whole one."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = (one.replace("\n", " ") for one in re.findall(r"`crowdbench ([^`]*)`", text))
    return [shlex.split(one) for one in found if "..." not in one and " > " not in one]


CALLS = [(page.name, arguments) for page in PAGES for arguments in (*commands(page), *inline(page))]
SHOWN = [(page, arguments) for page, arguments in CALLS if arguments[0] not in ELSEWHERE]


@pytest.mark.parametrize(
    ("page", "arguments"), SHOWN, ids=lambda each: each if isinstance(each, str) else " ".join(each)
)
def test_every_command_that_is_shown_is_one(page, arguments):
    check_command(app, page, arguments)


def check_command(app, page, arguments):
    command = get_command(app)
    name, *rest = arguments
    assert name in command.commands, f"{page} shows crowdbench {name}"
    found = command.commands[name]
    while rest and hasattr(found, "commands"):
        assert rest[0] in found.commands
        found = found.commands[rest.pop(0)]
    options = {option for parameter in found.params for option in (*parameter.opts, *parameter.secondary_opts)}
    assert [one for one in rest if one.startswith("--") and one.partition("=")[0] not in {*options, "--help"}] == []


def test_the_page_of_commands_has_all_of_them():
    page = (ROOT / "docs" / "commands.md").read_text()
    assert {*COMMANDS, *ELSEWHERE} == set(re.findall(r"`crowdbench ([\w-]+)[ `]", page))


def shorter(arguments):
    """A command with few cases."""
    few = {"1", "val:3", "val:20"} & set(arguments)
    return arguments if arguments[0] != "run" or few else [*arguments, "--cases", "val:2"]


def where_else(arguments):
    """Where a command is run if not here."""
    if arguments[0] in RUN_ELSEWHERE:
        return RUN_ELSEWHERE[arguments[0]]
    text = " ".join(arguments)
    places = {
        "--shard": "tests/commands/test_parts.py",
        "--workers": "tests/commands/test_workers.py",
        "--engine": "tests/commands/test_workers.py",
        "weights=runs": ".ci/train",
        "--data": "tests/unit/scenario/test_recorded.py",
        "number=10000": "tests/unit/sim/test_thousands.py",
        ".onnx": "tests/unit/envs/test_policy_planner.py and tests/unit/envs/test_envs_vehicle.py",
        "runs/drive": "tests/repository/test_ros2.py",
        "runs/my_stack": "tests/repository/test_ros2_live.py",
        "--format rosbag2": "tests/repository/test_ros2.py",
        "weights=mine.": "tests/parity/test_crowdnav_convert.py",
        "weights=CrowdNav_DSRNN": "tests/parity/test_ds_rnn_planner.py",
        "weights=pss_social": "tests/parity/test_pss_social_planner.py",
        "clone=": "tests/parity/test_crowdnav_planner.py and tests/parity/test_crowdnav_plus_planner.py",
        "$": "nowhere, because a shell has to fill in what it stands for",
    }
    return next((place for part, place in places.items() if part in text), "")


RUN_HERE = {page: here for page in PAGES if (here := [each for each in commands(page) if not where_else(each)])}


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN_HERE, ids=lambda page: page.name)
def test_the_commands_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # planners add their folders, which other tests must not find
    shown = []
    monkeypatch.setattr(viewer, "show", lambda file, *, web: shown.append(file))
    Path("studies").symlink_to(ROOT / "studies")  # commands name scenarios of studies
    if page.name == "planner.md":  # whose first block is the planner
        Path("mine.py").write_text(re.search(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)[1])
    for arguments in RUN_HERE[page]:
        run(*shorter(arguments))
    assert len(shown) == sum(arguments[0] == "view" for arguments in RUN_HERE[page])


def run(*arguments):
    app([*arguments], standalone_mode=False)


@pytest.mark.slow
def test_the_study_of_the_docs_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    texts = re.findall(r"^```toml\n(.*?)^```", (ROOT / "docs" / "paper.md").read_text(), re.DOTALL | re.MULTILINE)
    study, networks = (text.replace("val:40", "val:12") for text in texts)
    Path("mine.toml").write_text(study + networks)
    build_script(page)(["mine.toml"], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "## ORCA with and without a margin" in printed
    assert "## A margin of ORCA" in printed
    assert "ISRR 2011" in printed
    assert "### square_crossing_5, time_limit=20.0" in printed


@pytest.mark.parametrize("page", ["paper.md", "training.md"])
def test_the_python_of_the_docs_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.DOTALL | re.MULTILINE)
    assert found
    for text in found:
        exec(text, {"__name__": page})


@pytest.mark.slow
def test_the_notebook_of_the_docs_runs_and_the_site_shows_its_outputs(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    notebook = importlib.import_module("notebook_page")
    files, page = notebook.files(), notebook.page()
    assert len(files) == 3
    assert [name for name in files if name.endswith(".png") and f"]({name})" not in page] == []
    assert re.search(r"\| success \| success_rate \| [\d.]+ % \|", page)
    assert "| metric | orca | Waits | difference (95 % interval) | p | n |" in page
    assert page.endswith("```text\nTrue\n```")
