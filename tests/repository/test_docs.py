"""The pages of docs/ say what is there: the map of the folders, the way of one run, the API pages, the references."""

import re
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from crowdbench.catalog import PLANNERS
from crowdbench.export.replay_page import pack
from crowdbench.plugins.kind import load_module
from studies.publish import GENERATED, publish

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ARCHITECTURE = (DOCS / "architecture.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

MODULES = {path.parent.name for path in ROOT.glob("crowdbench/*/__init__.py")} | {
    path.stem for path in ROOT.glob("crowdbench/*.py") if not path.stem.startswith("__")
}
"""The folders and files directly under crowdbench/."""


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
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    beside = {f"{name.partition('/')[0]}/" for name in tracked if "/" in name} - {"crowdbench/"}
    second_table = ARCHITECTURE.split("| beside `crowdbench/` |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `([\w.]+/)", second_table, re.MULTILINE)) == beside


PAGES = sorted([*DOCS.glob("*.md"), *ROOT.glob("studies/*/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_between_the_pages_of_docs_and_of_studies_lead_to_files(page):
    linked = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text())
    assert [link for link in linked if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("file", sorted(ROOT.glob("studies/*/study.toml")), ids=lambda file: file.parent.name)
def test_the_page_of_a_study_has_its_description_its_tables_and_its_references(file):
    study = tomllib.loads(file.read_text())
    page = file.with_name("README.md").read_text()
    assert page.split("\n\n", 1)[1].startswith(study["description"])
    kinds = ("networks", "tables", "dials", "ladders", "rankings")
    titles = [table["title"] for kind in kinds for table in study.get(kind, [])]
    assert re.findall("^## (.+)$", page, re.MULTILINE) == titles
    assert [source for source in study.get("sources", []) if source not in page] == []


def test_every_page_is_in_the_menu_once():
    menu = re.findall(r" (\w+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert sorted(menu) == sorted(page.name for page in DOCS.glob("*.md"))


def test_the_page_of_planners_has_each_in_one_family():
    table = (DOCS / "planners.md").read_text().split("\n|---|---|---|\n")[1].split("\n\n")[0]
    assert sorted(re.findall(r"`(\w+)`", table)) == sorted(name for name, _ in PLANNERS.names())


def test_the_generated_reference_is_that_of_the_code():
    reference = load_module(DOCS / "reference.py")
    others = [path.name for path, text in reference.pages().items() if path.read_text() != text]
    assert others == [], "python docs/reference.py writes these pages"
    known = {f"{name}.md" for name, _ in PLANNERS.names()}
    assert {path.name for path in (DOCS / "planners").glob("*.md")} == known


def test_the_heat_table_is_drawn_from_its_script():
    figure = load_module(DOCS / "heat_figure.py")
    for path, ink in figure.INKS.items():
        assert path.read_text() == figure.figure(ink)
        assert float(re.search(r'width="(\d+)"', path.read_text())[1]) <= 1000


def test_a_printed_page_is_split_into_an_overview_and_tables():
    printed = (
        "Printed by `a command`.\n\n## Crowds\n\n| success | a |\n| --- | --- |\n| one | 1.0 % |\n\n"
        "### one\n\n| planner | success |\n| --- | --- |\n| a | **1.0 %** |\n\n"
        "| significantly better or worse than | a |\n| --- | --- |\n| b | better: time; worse: jerk, gap |\n\n"
        "### two\n\n| planner | success | wall |\n| --- | --- | --- |\n| a | 2.0 % | 3 |\n\nA note.\n"
    )
    page, files = publish(printed)
    assert page.startswith(f"Printed by `a command`. {GENERATED}\n\n## Crowds\n\n| success | a |")
    assert page.endswith(", [crowds_pairs.csv](tables/crowds_pairs.csv).\n\nA note.\n")
    assert files["crowds.csv"] == "scenario,planner,success,wall\none,a,1.0 %,\ntwo,a,2.0 %,3\n"
    assert files["crowds_pairs.csv"] == 'scenario,planner,other planner,better,worse,note\none,b,a,time,"jerk, gap",\n'
    assert publish(page) == (page, {})


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


def test_the_citation_file_has_the_version_of_the_project():
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [PROJECT["project"]["version"]]
    assert re.findall(r"^license: (.+)$", citation, re.MULTILINE) == [PROJECT["project"]["license"]]


def test_every_colour_of_a_figure_has_one_for_dark_pages():
    figures = [path for path in DOCS.rglob("*.svg") if path.name != "favicon.svg" and not path.name.startswith("heat_")]
    assert len(figures) > 20
    for path in figures:
        style, shapes = re.fullmatch(r"(.*?</style>)(.*)", path.read_text(), re.DOTALL).groups()
        used = set(re.findall(r"(?:fill|stroke): #\w+", shapes))
        assert used <= set(re.findall(r'\[style\*="((?:fill|stroke): #\w+)"\]', style)), path.name


def test_the_pages_of_planners_read_the_tracks_that_the_game_has():
    path_figure = load_module(DOCS / "path_figure.py")
    values = np.array([[0, -3, 40], [1, 5000, -70000]])
    assert (path_figure.unpack(pack(values)) == values.ravel()).all()
    case = path_figure.read_case(0)
    for planner in case["planners"]:
        path = path_figure.track(planner["track"], path_figure.COARSE)
        assert len(path) == planner["steps"] + 1
        assert np.abs(path[0] - case["start"]).max() < 1e-3
        if planner["outcome"] == "success":
            assert np.hypot(*(path[-1] - case["goal"])) < case["radius"] + 1e-2
    assert path_figure.chosen(["success"] * 30) == [0, 1, 2]
    assert path_figure.chosen(["collision"] * 30) == [0, 1, 2]
    assert path_figure.chosen(["success", "collision"] * 15) == [1, 3, 0]
