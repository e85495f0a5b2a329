"""The pages of the leaderboards, built from small boards."""

import csv
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from boards import make_key

from crowdbench.boards.board import read_board, read_boards
from crowdbench.boards.board_runs import read_episodes
from crowdbench.boards.entry import file_digests, read_entry, write_entry
from crowdbench.boards.season import freeze
from crowdbench.boards.submission import Submission, submit
from crowdbench.boards.verdict import (
    DecisionTime,
    Verdict,
    Verification,
    verification_folder,
    write_verification,
)
from crowdbench.plugins.load import load_module
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import plain

pytestmark = pytest.mark.slow


BOARDS = Path(__file__).parents[2] / "leaderboards"
build_site = load_module(BOARDS / "site" / "build.py").build_site
texts = load_module(BOARDS / "site" / "texts.py")
HOSTILE = '"><script>alert(1)</script><img src=http://evil.example/x onerror=alert(2)>{{ 7 * 7 }} $x_{1}$ \u202e'
STRANGE = {
    "title": HOSTILE,
    "paper": "javascript:alert(3)",
    "code": "https://example.org/?a=1&b=2",
    "privileged_training": True,
}
"""What the card of an entry says that may break a page."""


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Two boards, one with entries: two were verified in the season, of which one is hostile, and one was not."""
    root = tmp_path_factory.mktemp("site") / "leaderboards"
    for name in ("five", "suite"):
        board = (BOARDS / name / "board.toml").read_text()
        board = re.sub(r"(?m)^(cases|public_cases) = .*\n", "", board)
        (root / name).mkdir(parents=True)
        (root / name / "board.toml").write_text(board.replace("version", "cases = 6\npublic_cases = 6\nversion", 1))
    shutil.copy(BOARDS / "season.toml", root)
    enter(root, "five", "orca")
    enter(root, "five", "social_force", **STRANGE)
    boards = {board.name: board for board in read_boards(root)}
    entries = {name: [read_entry(path) for path in sorted((root / name).glob("entries/*"))] for name in boards}
    season = freeze(root, "five", {one.name: one.digest for one in entries["five"]})
    shutil.copytree(root / "five/entries/orca", root / "five/entries/late")
    late = read_entry(root / "five/entries/late")
    write_entry(late.directory, late.spec.model_copy(update={"submitted_by": "another"}))
    key = make_key(root.parent, root)
    for entry in entries["five"]:
        verified(entry, season, key)
    return root


def enter(root, board, planner, **card):
    text = (BOARDS / "cards" / f"{planner}.toml").read_text()
    for key, value in card.items():
        line = f"{key} = {json.dumps(value)}"
        text = re.sub(rf"(?m)^{key} = .*$", line.replace("\\", r"\\"), text)
    path = root.parent / f"{planner}.toml"
    path.write_text(text)
    submit(
        Submission(read_board(root / board), planner, planner, {}, [], path, f"Some Body of {planner}"),
        root,
        root.parent / "work",
    )


def verified(entry, season, key):
    """Record a verification, as `crowdbench verify --season` does, whose runs are those of the public cases."""
    board = read_board(season.root / entry.spec.board)
    speed = DecisionTime(p99_ms=1.0, kernel="k", kernel_ms=25.0, calibrated_p99_ms=1.0, is_real_time=True)
    found = Verification(
        by="tester",
        on="2027-01-31",
        board=entry.spec.board,
        board_digest=entry.spec.board_digest,
        entry=entry.name,
        entry_digest=entry.digest,
        season=season.spec.name,
        seed=season.seed(entry.spec.board),
        level="process",
        verdict=Verdict.RERUN,
        reason="as reported",
        figures={name: plain(run.summary()) for name, run in read_episodes(board, entry.public).items()},
        decision_time=speed,
    )
    write_verification(verification_folder(entry, season), found, board, entry.public, key)


@pytest.fixture(scope="module")
def site(root):
    out = root.parent / "site"
    assert build_site(root, out) == 1 + 2 + 3
    return out


class Page(HTMLParser):
    """The tags of a page, and its text."""

    def __init__(self, path):
        super().__init__()
        self.path, self.tags, self.text = path, [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def targets(self, *names):
        return [found for _, attrs in self.tags for name in names if (found := attrs.get(name)) is not None]


def pages(site):
    """The pages but for replays, which have tests of their own."""
    return [Page(path) for path in sorted(site.rglob("*.html")) if path.parent.name != "replay"]


def test_the_pages_of_one_board_are_made_alone(root, tmp_path):
    assert build_site(root, tmp_path / "one", ["suite"]) == 2
    assert "five" not in {path.name for path in (tmp_path / "one").iterdir()}
    with pytest.raises(InputError, match="no board is called 'six'; there are five, suite"):
        build_site(root, tmp_path / "two", ["six"])


def test_nothing_is_requested_from_elsewhere_and_every_link_leads_somewhere(site):
    for page in pages(site):
        outward = {target for tag, attrs in page.tags if tag == "a" for target in [attrs.get("href", "")]}
        for target in page.targets("src", "href", "xlink:href", "srcset", "data", "action"):
            parts = urlsplit(target)
            if target in outward and parts.scheme == "https":
                continue
            if parts.scheme == "data":
                assert target == "data:,"
                continue
            assert not parts.scheme, target
            assert not parts.netloc, target
            assert not parts.path.startswith("/"), target
            file = page.path.parent / unquote(parts.path) if parts.path else page.path
            assert file.is_file(), target
            if parts.fragment and file.parent.name != "replay":
                assert parts.fragment in page.targets("id"), target
    assert "http" not in (site / "style.css").read_text()


def test_the_start_page_links_every_page(site):
    index = Page(site / "index.html")
    linked = {(site / unquote(target)).resolve() for target in index.targets("href") if target.endswith(".html")}
    assert linked | {(site / "index.html").resolve()} == {page.path.resolve() for page in pages(site)}


def test_pages_and_replays_are_small(site):
    assert len(list(site.rglob("replay/data/*/*.js"))) == 6
    assert all(path.stat().st_size < 100_000 for path in site.rglob("*") if path.is_file())


def test_what_strangers_write_is_text(site):
    for page in pages(site):
        assert not [attrs for _, attrs in page.tags if any(name.startswith("on") for name in attrs)]
        assert not {tag for tag, _ in page.tags} & {"img", "iframe", "object", "embed", "form", "b<"}
        source = page.path.read_text(encoding="utf-8")
        assert "<script>alert" not in source
        assert "javascript:" not in "".join(page.targets("href"))
        assert "\u202e" not in source
    entry = Page(site / "five" / "entries" / "social_force.html")
    text = "".join(entry.text)
    assert "<script>alert(1)</script>" in text
    assert "{{ 7 * 7 }}" in text
    assert "Some Body" in text
    assert "https://example.org/?a=1&b=2" in entry.targets("href")


def test_everything_is_there_without_javascript(site):
    text = "".join(Page(site / "five" / "index.html").text)
    for word in (
        "orca",
        "re-run",
        "success, %",
        "Tests between entries",
        "Failures by case",
        "real-time",
        "1 to 2",
        "Primary endpoint: success.",
    ):
        assert word in text, word
    assert "button" not in {tag for tag, _ in Page(site / "five" / "index.html").tags}
    assert "No entry is ranked on this board yet." in "".join(Page(site / "suite" / "index.html").text)
    reported = (site / "five" / "index.html").read_text(encoding="utf-8")
    assert '<tr class="reported" data-tags="not learned,predicts people">' in reported
    assert "reported only" in reported
    index = "".join(Page(site / "index.html").text)
    assert "This season is a rehearsal." in index
    assert str(json.loads((site.parent / "leaderboards/frozen.json").read_text())["season"]) in index


@pytest.fixture
def page(site):
    """The page of a board in headless Chromium at the width of a phone; nothing is on its console."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs Chromium")
    said = []
    with playwright.sync_playwright() as started:
        one = started.chromium.launch(executable_path=chromium).new_page(viewport={"width": 390, "height": 844})
        one.on("console", lambda message: said.append(message.text))
        one.on("pageerror", lambda error: said.append(str(error)))
        one.goto((site / "five" / "index.html").as_uri())
        yield one
        one.context.browser.close()
    assert said == []


def test_a_phone_shows_the_page_and_columns_can_be_sorted(page):
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    head = page.locator("table[data-sortable]").first.locator("th[data-sort]").filter(has_text=re.compile("^time"))
    column = head.evaluate("each => each.cellIndex")
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    rows = page.locator("table[data-sortable]").first.locator("tbody tr").all()
    values = [float(row.locator("> *").nth(column).get_attribute("data-v")) for row in rows]
    assert len(values) == 2
    assert values == sorted(values)


def test_entries_are_filtered_and_leave_as_csv(page):
    bar, rows = page.locator(".filters").first, page.locator("table.entries").first.locator("tbody tr")
    bar.get_by_role("searchbox").fill("optimal reciprocal")
    assert rows.filter(visible=True).count() == 0
    bar.get_by_role("searchbox").fill("ORCA")
    assert rows.filter(visible=True).count() == 1
    assert "1 of 2" in bar.inner_text()
    with page.expect_download() as download:
        bar.get_by_role("link", name="CSV").click()
    header, *lines = list(csv.reader(download.value.path().read_text().splitlines()))
    assert header[1:3] == ["entry", "success, %"]
    assert [line[1] for line in lines] == ["ORCA"]
    bar.get_by_role("searchbox").fill("")
    assert rows.filter(visible=True).count() == 2
    bar.get_by_role("checkbox", name="privileged").check()
    assert ["alert(1)" in row.inner_text() for row in rows.filter(visible=True).all()] == [True]


def test_failures_lead_to_their_replays(site, root):
    entry = (site / "five" / "entries" / "orca.html").read_text(encoding="utf-8")
    rows = (root / "five/entries/orca/public/circle_crossing_5/episodes.csv").read_text().splitlines()[1:]
    collided = [row.split(",")[0] for row in rows if row.split(",")[1] == "collision"]
    assert collided
    for case in collided:
        assert f"Case {case}: collision" in entry
        assert f'"../replay/index.html#circle_crossing_5/test/{case}/orca"' in entry
        data = (site / f"five/replay/data/circle_crossing_5/test-{case}.js").read_text()
        assert json.loads(data.partition(",")[2][:-2])["orca"]["outcome"] == "c"
    assert entry.count("Collision with pedestrian") == len(collided)
    assert "reported:" not in entry


def test_outside_a_season_each_cell_of_who_fails_where_leads_to_its_replay(root, tmp_path):
    shutil.copytree(root / "five/entries/late", tmp_path / "five/entries/late")
    shutil.copy(root / "five/board.toml", tmp_path / "five")
    assert build_site(tmp_path, tmp_path / "site") == 3
    page = Page(tmp_path / "site/five/index.html")
    episodes = read_episodes(read_board(tmp_path / "five"), tmp_path / "five/entries/late/public")["circle_crossing_5"]
    failed = [case for cases in episodes.failures.values() for case in cases]
    links = {target for target in page.targets("href") if "#circle" in target}
    assert links == {f"replay/index.html#circle_crossing_5/test/{case}/late" for case in failed}


def test_a_damaged_run_leaves_the_page_without_a_replay(root, tmp_path):
    shutil.copytree(root / "five/entries/late", tmp_path / "five/entries/late")
    shutil.copy(root / "five/board.toml", tmp_path / "five")
    entry = read_entry(tmp_path / "five/entries/late")
    (entry.directory / "public/circle_crossing_5/commands.parquet").write_bytes(b"nothing")
    write_entry(entry.directory, entry.spec.model_copy(update={"files": file_digests(entry.directory)}))
    assert build_site(tmp_path, tmp_path / "site") == 3
    text = (tmp_path / "site/five/entries/late.html").read_text(encoding="utf-8")
    assert "They cannot be simulated again" in text
    assert not (tmp_path / "site/five/replay").exists()
    assert "There is no season yet" in (tmp_path / "site/index.html").read_text(encoding="utf-8")


def test_the_same_boards_give_the_same_bytes(site, root):
    before = {path.relative_to(site): path.read_bytes() for path in site.rglob("*") if path.is_file()}
    build_site(root, site)
    after = {path.relative_to(site): path.read_bytes() for path in site.rglob("*") if path.is_file()}
    assert before == after
    assert [path.name for path in site.parent.iterdir() if path.name.startswith(".site")] == []


def test_a_folder_of_something_else_is_kept(tmp_path, root):
    (tmp_path / "thesis.txt").write_text("kept")
    with pytest.raises(InputError, match="holds something other than the pages of leaderboards"):
        build_site(root, tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "kept"


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("https://example.org/a", "https://example.org/a"),
        ("arXiv:2011.11191", "https://arxiv.org/abs/2011.11191"),
        ("10.1007/978-3-642-19457-3_1", "https://doi.org/10.1007/978-3-642-19457-3_1"),
        ("javascript:alert(1)", ""),
        ("JavaScript:alert(1)//https://a.b", ""),
        ("data:text/html,x", ""),
        ("file:///etc/passwd", ""),
        ("https:///nowhere", ""),
        ("http://[broken", ""),
        ("//example.org", ""),
        ("https://example.org/ x", ""),
        ("agents/planners of crowdbench", ""),
        ("", ""),
    ],
)
def test_links_lead_only_to_the_web(text, address):
    assert texts.web_address(text) == address


def test_numbers_are_written_with_their_digits():
    assert texts.metric(0.8666, "success_rate") == "86.7"
    assert texts.number(-0.001) == "0.00"
    assert texts.number(-0.5) == "\N{MINUS SIGN}0.50"
    assert texts.number(np.nan) == texts.metric(None, "jerk") == texts.NOTHING
