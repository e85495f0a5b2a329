"""The pages of docs/ say what is there: the map of the folders, the way of one run, the API pages, the references."""

import dataclasses
import inspect
import re
import shutil
import sys
import tomllib
from pathlib import Path

import pytest
from readme import write_readme
from typer.testing import CliRunner

import crowdbench
from crowdbench.cli import app
from crowdbench.core.types.observation import Observation, Pedestrians, Vehicle
from crowdbench.plugins.load import load_module
from crowdbench.utils.tables import printed_by

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ARCHITECTURE = (DOCS / "architecture.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FIGURE = load_module(DOCS / "run_figure.py")

MODULES = {path.parent.name for path in ROOT.glob("crowdbench/*/__init__.py")} | {
    path.stem for path in ROOT.glob("crowdbench/*.py") if not path.stem.startswith("__")
}
"""The folders and files directly under crowdbench/."""


def under_crowdbench(name):
    """The file of an entry of the figure."""
    return name if name.startswith("agents/") else f"crowdbench/{name}"


def rows(heading):
    """The first cells of the first table under a heading."""
    table = ARCHITECTURE.split(f"## {heading}\n")[1].split("|---|\n")[1].split("\n\n")[0]
    return re.findall(r"^\| (.+?) \|", table, re.MULTILINE)


def test_every_path_that_the_architecture_names_exists():
    named = [
        name for name in re.findall(r"`([\w./]+)`", ARCHITECTURE) if "/" in name or name.endswith((".py", ".toml"))
    ]
    assert len(named) > 60
    assert [name for name in named if not (ROOT / name).exists() and not (ROOT / "crowdbench" / name).exists()] == []


def test_every_folder_and_module_is_on_the_map_once():
    mapped = [name for row in rows("The folders") for name in re.findall(r"`(\w+)(?:/|\.py)`", row)]
    assert sorted(mapped) == sorted(MODULES)


def test_every_folder_beside_the_package_is_on_the_map():
    ignored = {".git/", "crowdbench/", *(line.lstrip("/") for line in (ROOT / ".gitignore").read_text().split())}
    beside = {f"{path.name}/" for path in ROOT.iterdir() if path.is_dir()} - ignored
    second_table = ARCHITECTURE.split("| beside `crowdbench/` |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `([\w.]+/)", second_table, re.MULTILINE)) == beside


def test_the_table_of_what_a_planner_is_given_is_whole():
    table = (DOCS / "plugins.md").read_text().split("| in `obs` |")[1].split("\n\n")[0]
    named = {name.split(".")[-1] for name in re.findall(r"`([\w.]+)`", table)}
    given = [field.name for part in (Observation, Vehicle, Pedestrians) for field in dataclasses.fields(part)]
    parts_and_what_is_called = {"vehicle", "pedestrians", "noise_key", "future", "logs"}  # noise(), true_next(), log()
    assert set(given) - named == parts_and_what_is_called


def test_the_map_stands_in_the_order_of_the_imports():
    layers = PROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
    layer_of = {name: i for i, layer in enumerate(layers) for name in re.findall(r"crowdbench\.(\w+)", layer)}
    order = [layer_of[name] for row in rows("The folders") for name in re.findall(r"`(\w+)(?:/|\.py)`", row)]
    assert order == sorted(order)


def test_the_list_and_the_figure_have_the_same_files_each_once():
    listed = re.findall(r"^\| (\d+) \| `(.+?)` \|", ARCHITECTURE, re.MULTILINE)
    drawn = [under_crowdbench(file) for _, file, _ in FIGURE.RUN]
    assert listed == [(str(i), file) for i, file in enumerate(drawn, 1)]
    assert len(set(drawn)) == len(drawn)


def test_the_figure_is_drawn_from_its_script():
    assert FIGURE.FIGURE.read_text() == FIGURE.figure()


def test_a_run_goes_the_way_of_the_figure(tmp_path):
    """Each file is entered from the one that it is indented under, and those of a decision from the planner."""
    tree = [(depth, str(ROOT / under_crowdbench(file))) for depth, file, _ in FIGURE.RUN]
    expected = {
        (next((caller for above, caller in reversed(tree[:i]) if above == depth - 1), None), file)
        for i, (depth, file) in enumerate(tree)
    }
    planner = str(ROOT / "crowdbench" / "planners" / "lookahead.py")
    inside = re.findall(r"^\d+\. `(.+?)`:", ARCHITECTURE, re.MULTILINE)
    assert len(inside) > 5
    expected |= {(planner, str(ROOT / file)) for file in inside}
    files = {file for _, file in expected}
    calls = set()

    def profile(frame, event, argument):
        code = frame.f_code
        called = code.co_flags & inspect.CO_OPTIMIZED or "/agents/" in code.co_filename  # no import, but of a plug-in
        if event != "call" or not called or code.co_filename not in files:
            return
        caller = frame.f_back
        while caller is not None and caller.f_code.co_filename not in files:
            caller = caller.f_back
        calls.add((caller and caller.f_code.co_filename, code.co_filename))

    command = ["run", "--planner", "sarl_sgan_kce", "--cases", "val:1", "--out", str(tmp_path / "run")]
    sys.setprofile(profile)
    try:
        result = CliRunner().invoke(app, command)
    finally:
        sys.setprofile(None)
    assert result.exit_code == 0, result.output
    assert expected - calls == set()


TABLES = ("suite", "learned", "policies", "crowds", "kce", "recorded", "specialists", "crowdnav_plus")
PRINTED = {f"studies/{name}/README.md": f"python studies/run.py studies/{name}/study.toml" for name in TABLES}
PRINTED["studies/recorded/README.md"] += " --data DIR"
SCRIPTS = {
    "published": " NETWORKS --cases val:10",
    "validity": "",
    "transfer": " --data DIR",
    "ladder": "",
    "dials": "",
    "li2020": "",
    "learn_together": "",
    "reactions": " --cases val:20",
}
PRINTED |= {f"studies/{name}/README.md": f"python studies/{name}/run.py{data}" for name, data in SCRIPTS.items()}
PRINTED["studies/validity/motion.md"] = "python studies/validity/motion.py --data DIR"
PRINTED["docs/noticing.md"] = "python docs/noticing_page.py"
"""The pages that a command prints from the first to the last line, and the command."""

PAGES = sorted([*DOCS.glob("*.md"), *ROOT.glob("studies/*/*.md")])


@pytest.mark.parametrize("page", PRINTED)
def test_a_page_that_a_command_prints_names_the_command_on_its_first_lines(page):
    assert printed_by(PRINTED[page]) in (ROOT / page).read_text().splitlines()[:3]


def test_no_other_page_says_that_a_command_printed_it():
    first, last = printed_by("|").split("|")
    said = [page for page in PAGES if first in page.read_text() and last in page.read_text()]
    assert sorted(page.relative_to(ROOT).as_posix() for page in said) == sorted(PRINTED)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_between_the_pages_of_docs_and_of_studies_lead_to_files(page):
    linked = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text())
    assert [link for link in linked if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("folder", [path.name for path in sorted(ROOT.glob("studies/*/"))])
def test_the_readme_of_a_study_names_its_command(folder):
    assert re.search(
        rf"`python (studies/run.py )?studies/{folder}/", (ROOT / "studies" / folder / "README.md").read_text()
    )


@pytest.mark.parametrize("file", sorted(ROOT.glob("studies/*/study.toml")), ids=lambda file: file.parent.name)
def test_the_page_of_a_study_has_its_description_its_tables_and_its_references(file):
    study = tomllib.loads(file.read_text())
    page = file.with_name("README.md").read_text()
    assert page.split("\n\n", 1)[1].startswith(study["description"])
    kinds = ("networks", "tables", "dials", "ladders", "rankings")
    titles = [table["title"] for kind in kinds for table in study.get(kind, [])]
    assert re.findall("^## (.+)$", page, re.MULTILINE) == titles
    assert [source for source in study.get("sources", []) if source not in page] == []


@pytest.mark.parametrize("name", ["suite", "recorded", "crowdnav_plus"])
def test_the_tables_and_what_they_show_link_to_each_other(name):
    assert f"(../studies/{name}/README.md)" in (DOCS / f"{name}.md").read_text()
    assert f"(../../docs/{name}.md" in (ROOT / "studies" / name / "README.md").read_text()


def test_the_start_page_links_every_page():
    start = (DOCS / "index.md").read_text()
    pages = [page.name for page in DOCS.glob("*.md")]
    pages += [f"../{page.relative_to(ROOT).as_posix()}" for page in ROOT.glob("studies/*/*.md")]
    assert [page for page in pages if f"({page})" not in start] == ["index.md"]


def test_every_module_has_its_place_in_the_api_pages():
    pages = [path.read_text() for path in (DOCS / "api").glob("*.md")]
    described = re.findall(r"^::: crowdbench\.(\w+)$", "\n".join(pages), re.MULTILINE)
    assert sorted(described) == sorted(MODULES)


def test_every_public_name_is_on_the_first_api_page():
    page = (DOCS / "api" / "index.md").read_text()
    assert sorted(re.findall(r"^\| \[?`(\w+)`", page, re.MULTILINE)) == sorted(crowdbench.__all__)


CITATION = re.compile(
    r"(?<![\w-])(?P<first>[A-Z][\w-]+|van den Berg|Van Der Meer) et al\.,? \(?(?P<year>\d{4})"
    r"|(?<!\w, )\b(?P<one>[A-Z][\w-]+) and (?P<two>[A-Z]\w+),? \(?(?P<pair>\d{4})"
    r"|\((?P<single>[A-Z]\w+),? (?P<alone>(?:19|20)\d{2})\)"
)


def citations(text):
    """The works that a text cites, as the list of references names them."""
    for found in CITATION.finditer(re.sub(r"\s+(?:# )?", " ", text)):
        if found["first"]:
            yield f"{found['first']} et al. ({found['year']})"
        elif found["one"]:
            yield f"{found['one']} and {found['two']} ({found['pair']})"
        else:
            yield f"{found['single']} ({found['alone']})"


CITING = ["crowdbench", "adapters", "agents", "docs", "scenarios", "studies", "examples", "."]


@pytest.mark.parametrize("folder", CITING)
def test_every_work_that_is_cited_is_among_the_references(folder):
    pattern = "*.md" if folder == "." else "**/*.*"
    files = [path for path in (ROOT / folder).glob(pattern) if path.suffix in (".py", ".md", ".toml")]
    cited = {work for path in files for work in citations(path.read_text())}
    known = re.findall(r"^- \*\*(.+?)\.?\*\*", (DOCS / "references.md").read_text(), re.MULTILINE)
    assert files
    assert cited - set(known) == set()


def test_a_missing_reference_would_be_seen():
    text = "(Nobody et al. 1999), Ada and Bob (2001), (Hall\n# 1966)"
    assert list(citations(text)) == ["Nobody et al. (1999)", "Ada and Bob (2001)", "Hall (1966)"]


def test_the_citation_file_has_the_version_of_the_project():
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [PROJECT["project"]["version"]]
    assert re.findall(r"^license: (.+)$", citation, re.MULTILINE) == [PROJECT["project"]["license"]]


def test_the_readme_says_so_while_the_boards_are_being_filled():
    pages = [ROOT / "README.md", ROOT / "leaderboards" / "README.md", DOCS / "boards.md"]
    has_entries = any((ROOT / "leaderboards").glob("*/entries/*"))
    assert ["boards are being filled" in page.read_text() for page in pages] == [not has_entries] * 3


@pytest.mark.slow
def test_the_readme_shows_the_suite_as_its_page_has_it():
    suite = (ROOT / "studies" / "suite" / "README.md").read_text()
    tables = [
        [[cell.strip(" *`%") for cell in row.strip("|").split("|")] for row in table.splitlines()]
        for table in re.findall(r"^\| success[^\n]+\n(?:\|.+\n)+", suite, re.MULTILINE)
    ]
    page = {
        (row[0], name): cell
        for (head, _, *rows) in reversed(tables)  # the first counts, which has the most cases
        for row in rows
        for name, cell in zip(head, row, strict=True)
    }
    shown = re.search(r"^\| success, %[^\n]+\n(?:\|.+\n)+", (DOCS.parent / "README.md").read_text(), re.MULTILINE)[0]
    head, _, *rows = [[cell.strip(" *`") for cell in row.strip("|").split("|")] for row in shown.splitlines()]
    for name, *cells in rows:
        for planner, cell in zip(head[1:], cells, strict=True):
            label = f"{planner} (filter=kalman)" if planner in ("dwa", "mppi") else planner
            assert page[name, label] == cell
    assert len(rows) == 15


@pytest.mark.slow
def test_the_standings_in_leaderboards_are_those_of_its_entries(tmp_path):
    shutil.copytree(ROOT / "leaderboards", tmp_path / "leaderboards")
    written = write_readme(tmp_path / "leaderboards").read_text()
    assert written == (ROOT / "leaderboards" / "README.md").read_text()
