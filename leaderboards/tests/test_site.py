"""The pages of the leaderboards, built from small boards, and the tables and replays of the documentation site."""

import csv
import functools
import http.server
import json
import re
import shutil
import threading
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from board_entries import change_rows
from boards_site import build_site
from small_boards import make_key

from crowdbench.plugins.kind import load_module
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.episode_table import read_table
from crowdbench_leaderboards.pages import texts
from crowdbench_leaderboards.season import freeze
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verdict import (
    DecisionTime,
    Verdict,
    Verification,
    write_verification,
)

pytestmark = pytest.mark.slow


ROOT = Path(__file__).parents[2]
BOARDS = ROOT / "leaderboards"
HOSTILE = '"><script>alert(1)</script><img src=http://evil.example/x onerror=alert(2)>{{ 7 * 7 }} $x_{1}$ \u202e'
STRANGE = {
    "method": HOSTILE,
    "description": HOSTILE,
    "contact": HOSTILE,
    "paper": "javascript:alert(3)",
    "code": "https://example.org/?a=1&b=2",
    "privileged_training": True,
}
"""What the card of an entry says that may break a page."""


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Three boards: one with three entries (two verified, of which one is hostile), an empty one, one without ranks."""
    root = tmp_path_factory.mktemp("site") / "leaderboards"
    for name, source in {"five": "five", "suite": "suite", "unranked": "ten"}.items():
        board = (BOARDS / source / "board.toml").read_text()
        board = board.replace("version", "ranked = false\nversion", 1) if name == "unranked" else board
        board = re.sub(r"(?m)^(cases|public_cases) = .*\n", "", board)
        (root / name).mkdir(parents=True)
        (root / name / "board.toml").write_text(board.replace("version", "cases = 6\npublic_cases = 6\nversion", 1))
    shutil.copy(BOARDS / "season.toml", root)
    (root / "shipped.toml").write_text('[[shipped]]\nname = "orca"\nplanner = "orca"\n')
    enter(root, "five", "orca")
    enter(root, "unranked", "orca")
    enter(root, "five", "social_force", account="some-body", **STRANGE)
    board = read_board(root / "five")
    season = freeze(root, "five", read_entries(board, root).good)
    enter(root, "five", "straight", account="another")
    (root / "five/entries/straight").rename(root / "five/entries/late")
    shutil.copytree(root / "five/entries/late", root / "five/entries/late_")
    key = make_key(root.parent, root)
    for name in ("orca", "social_force"):
        verified(read_entry(root / "five/entries" / name), board, season, key)
    return root


def enter(root, board, planner, **card):
    text = (BOARDS / "cards" / f"{planner}.toml").read_text()
    for key, value in card.items():
        line = f"{key} = {json.dumps(value)}\n"
        text = re.sub(rf"(?m)^{key} = .*\n", "", text) + line
    path = root.parent / f"{planner}.toml"
    path.write_text(text)
    submission = Submission(read_board(root / board), planner, planner, {}, [], path)
    submit(submission, root, root.parent / "work")


def verified(entry, board, season, key):
    """Record a verification, as `crowdbench verify --season` does, whose cases are the public ones."""
    found = Verification(
        by="tester",
        on="2027-01-31",
        board=entry.spec.board,
        board_digest=entry.spec.board_digest,
        entry=entry.name,
        entry_digest=entry.digest,
        season=season.spec.name,
        seed=season.seed(entry.spec.board),
        level="bubblewrap",
        verdict=Verdict.RERUN,
        reason="as reported",
        decision_time=DecisionTime(p99_ms=1.0, in_time=1.0, is_real_time=True),
    )
    episodes = read_table(entry.directory / "public.parquet", board, board.public_cases)
    write_verification(entry.directory, found, episodes, key)


@pytest.fixture(scope="module")
def site(root):
    return build_site(root, root.parent / "built")


class Page(HTMLParser):
    """The tags of a page, its text, and its source: all of it, or what the theme puts into its frame."""

    def __init__(self, path, is_whole=False):
        super().__init__()
        self.path, self.tags, self.text, self.source = path, [], [], path.read_text(encoding="utf-8")
        if not is_whole:
            self.source = self.source.partition("md-content__inner")[2].rpartition("</article>")[0]
        self.feed(self.source)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def targets(self, *names):
        return [found for _, attrs in self.tags for name in names if (found := attrs.get(name)) is not None]


def pages(site, is_whole=False):
    """The pages but for replays, which have tests of their own."""
    paths = sorted((site / "leaderboards").rglob("*.html"))
    return [Page(path, is_whole) for path in paths if path.parent.name != "replay"]


def test_there_is_a_page_of_all_boards_of_each_board_and_of_each_entry(site):
    entries = [f"five/entries/{name}.html" for name in ("late", "orca", "social_force")]
    found = [page.path.relative_to(site / "leaderboards").as_posix() for page in pages(site)]
    boards = [f"{name}/index.html" for name in ("five", "suite", "unranked")]
    assert sorted(found) == sorted(["index.html", *boards, "unranked/entries/orca.html", *entries])


def test_nothing_is_requested_from_elsewhere_and_every_link_leads_somewhere(site):
    ids = functools.cache(lambda path: Page(path, is_whole=True).targets("id"))
    for page in pages(site, is_whole=True):
        outward = {target for tag, attrs in page.tags if tag == "a" for target in [attrs.get("href", "")]}
        for target in page.targets("src", "href", "xlink:href", "srcset", "data", "action"):
            parts = urlsplit(target)
            if target in outward and parts.scheme == "https":
                continue
            assert not parts.scheme, target
            assert not parts.netloc, target
            assert not parts.path.startswith("/"), target
            file = (page.path.parent / unquote(parts.path)).resolve() if parts.path else page.path
            assert file.is_file() or file == site, target
            if parts.fragment and file.parent.name != "replay":
                assert parts.fragment in ids(file), target


def test_every_entry_is_linked_by_its_board_and_every_board_by_the_page_of_all(site):
    folder = site / "leaderboards"
    linked = set()
    for page in pages(site):
        if page.path.name == "index.html":
            linked |= {(page.path.parent / unquote(target)).resolve() for target in page.targets("href")}
    assert {page.path.resolve() for page in pages(site)} <= linked | {(folder / "index.html").resolve()}


def test_the_menu_has_each_board_and_the_search_has_boards_without_entries(site):
    menu = Page(site / "index.html", is_whole=True).targets("href")
    assert {f"leaderboards/{name}.html" for name in ("index", "five/index", "suite/index")} <= set(menu)
    found = json.loads((site / "search/search_index.json").read_text(encoding="utf-8"))["docs"]
    assert "leaderboards/five/index.html#ranking" in {each["location"] for each in found}
    assert [each["location"] for each in found if "/entries/" in each["location"]] == []
    assert "alert(1)" not in json.dumps([each["title"] for each in found])


def test_pages_and_replays_are_small(site):
    assert len(list(site.rglob("five/replay/data/*/*.js"))) == 6
    assert all(path.stat().st_size < 100_000 for path in (site / "leaderboards").rglob("*") if path.is_file())


def test_what_strangers_write_is_text(site):
    for page in pages(site):
        assert not [attrs for _, attrs in page.tags if any(name.startswith("on") for name in attrs)]
        assert not {tag for tag, _ in page.tags} & {"img", "iframe", "object", "embed", "form", "b<"}
        whole = page.path.read_text(encoding="utf-8")
        assert "<script>alert" not in whole
        assert "javascript:alert" not in "".join(page.targets("href"))
        assert "\u202e" not in whole
    entry = Page(site / "leaderboards/five/entries/social_force.html", is_whole=True)
    text = "".join(entry.text)
    assert text.count("<script>alert(1)</script>") >= 2
    assert "{{ 7 * 7 }}" in text
    assert "some-body" in text
    assert "https://example.org/?a=1&b=2" in entry.targets("href")


def test_everything_is_there_without_javascript(site):
    page = Page(site / "leaderboards/five/index.html")
    text = "".join(page.text)
    for word in (
        "orca",
        "re-run",
        "score",
        "Tests between entries",
        "Failures in public cases",
        "real-time",
        "late_",  # which is left out
        "The rank is an interval",
    ):
        assert word in text, word
    assert "button" not in {tag for tag, _ in page.tags}
    assert "No entry is ranked on this board yet." in "".join(Page(site / "leaderboards/suite/index.html").text)
    unranked = "".join(Page(site / "leaderboards/unranked/index.html").text)
    assert "This board has no ranks: it shows results only." in unranked
    assert "Ranking" not in unranked
    assert "orca" in unranked
    rows = {attrs["data-tags"]: attrs["class"] for tag, attrs in page.tags if tag == "tr" and "data-tags" in attrs}
    assert rows == {"reactive;real-time;": "", "reactive;real-time;privileged": "", "reactive;;": "reported"}
    index = "".join(Page(site / "leaderboards/index.html").text)
    assert "This season is a rehearsal." in index
    assert str(json.loads((site.parents[1] / "leaderboards/frozen.json").read_text())["season"]) in index


@pytest.fixture(scope="module")
def address(site):
    """A server of the site on this machine: without one, the theme cannot load the index of its search."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=site)
    handler.func.log_message = lambda *_: None
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs Chromium")
    with playwright.sync_playwright() as started:
        one = started.chromium.launch(executable_path=chromium)
        yield one
        one.close()


@pytest.fixture
def visit(address, browser):
    """Open a page; afterwards, nothing was on the console, and nothing was requested from elsewhere."""
    wrong, opened = [], []

    def go(link, width=390, scheme="light"):
        page = browser.new_page(viewport={"width": width, "height": 844}, color_scheme=scheme)
        opened.append(page)
        page.on("console", lambda message: wrong.extend(texts_of(message)))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.extend(url_of_failure(request)))
        page.on("request", lambda one: wrong.extend([one.url] * (not one.url.startswith((address, "data:", "blob:")))))
        page.goto(address + link)
        return page

    yield go
    for page in opened:
        page.close()
    assert wrong == []


def url_of_failure(request):
    """The URL of a failed request, unless the page was left or closed before it was answered."""
    return [] if request.failure == "net::ERR_ABORTED" else [request.url]


def texts_of(message):
    """The text of a message, unless it is on the list of versions, which mike writes when it publishes the site."""
    url = message.location["url"]
    return [] if url.endswith("/versions.json") else [f"{message.text} {url}"]


BOARD = "leaderboards/five/index.html"
SHOWN = ["leaderboards/index.html", BOARD, "leaderboards/five/entries/orca.html", "results.html"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize(
    "link", ["leaderboards/index.html", BOARD, "leaderboards/five/entries/orca.html", "results.html"]
)
def test_a_page_fits_its_screen_and_has_the_colours_of_the_site(visit, link, width, scheme):
    page = visit(link, width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/\\d+/)[0]")
    assert (int(ground) > 127) == (scheme == "light")
    assert page.get_by_role("navigation", name="Tabs").is_visible() == (width == 1280)


def test_columns_can_be_sorted(visit):
    table = visit(BOARD).locator("table.entries").first
    head = table.locator("thead th").filter(has_text=re.compile("^time, s"))
    column = head.evaluate("each => each.cellIndex")
    for order in ("ascending", "descending"):
        head.get_by_role("button").click()
        assert head.get_attribute("aria-sort") == order
        rows = table.locator("tbody tr").all()
        values = [float(row.locator("> *").nth(column).get_attribute("data-v")) for row in rows]
        assert len(values) == 2
        assert values == sorted(values, reverse=order == "descending")


def test_entries_are_filtered_and_leave_as_csv(visit):
    page = visit(BOARD)
    bar, rows = page.locator(".bar").first, page.locator("table.entries").first.locator("tbody tr")
    search = bar.get_by_role("searchbox")
    search.fill("optimal reciprocal")
    assert rows.filter(visible=True).count() == 0
    search.fill("ORCA")
    assert rows.filter(visible=True).count() == 1
    assert "1 of 2" in bar.inner_text()
    bar.get_by_text("Columns").click()
    bar.get_by_role("checkbox", name="verification").uncheck()
    with page.expect_download() as download:
        bar.get_by_role("link", name="CSV").click()
    header, *lines = list(csv.reader(download.value.path().read_text().splitlines()))
    assert header[1:3] == ["entry", "score"]
    assert header[-1] == "account"
    assert "verification" not in header
    assert [line[1] for line in lines] == ["orca"]
    search.fill("")
    assert rows.filter(visible=True).count() == 2
    assert bar.get_by_role("checkbox", name="reactive").count() == 0  # since all of them are
    bar.get_by_role("checkbox", name="privileged").check()
    assert ["social_force" in row.inner_text() for row in rows.filter(visible=True).all()] == [True]


def test_a_cell_of_who_fails_where_leads_to_its_case_in_the_replay(visit):
    page = visit(BOARD, 1280)
    cell = page.locator("table.cases td a").filter(has_text="C").first
    case = re.search(r"#circle_crossing_5/(test/\d+)/", cell.get_attribute("href"))[1]
    cell.click()
    page.wait_for_function(f"document.title.startsWith('circle_crossing_5, case {case}')")
    page.keyboard.press("End")
    assert "collision" in page.locator(".verdict").inner_text().lower()


def test_the_tables_of_studies_are_sorted_filtered_and_leave_as_csv(visit):
    page = visit("results.html#suite", 1280)
    table = page.locator("#data table")
    table.locator("tbody tr").first.wait_for()
    before = table.locator("tbody tr").count()
    page.get_by_role("searchbox", name="Filter rows").fill(table.locator("tbody td").first.inner_text())
    assert 0 < table.locator("tbody tr").filter(visible=True).count() < before
    table.locator("thead button").nth(1).click()
    with page.expect_download() as download:
        page.locator("#data").get_by_role("link", name="CSV").click()
    header, *lines = list(csv.reader(download.value.path().read_text().splitlines()))
    assert len(lines) == table.locator("tbody tr").filter(visible=True).count()
    assert {len(line) for line in lines} == {len(header)}
    page.get_by_role("combobox", name="Study").select_option("kce")
    page.wait_for_function("location.hash === '#kce'")


@pytest.mark.parametrize("is_in_season", [True, False])
def test_each_entry_and_each_public_case_leads_to_its_replay(site, root, tmp_path, is_in_season):
    if not is_in_season:
        shutil.copytree(root / "five/entries/late", tmp_path / "boards/five/entries/late")
        shutil.copy(root / "five/board.toml", tmp_path / "boards/five")
        site = build_site(tmp_path / "boards", tmp_path)
    page = Page(site / BOARD)
    links = [target for target in page.targets("href") if target.startswith("replay/index.html#")]
    expected = []
    board = read_board(root / "five")
    for name in ("late", "orca", "social_force") if is_in_season else ("late",):
        table = root / f"five/entries/{name}/public.parquet"
        episodes = read_table(table, board, board.public_cases)["circle_crossing_5"]
        failed = {case for cases in episodes.failures.values() for case in cases}
        expected.append((name, failed))
    shown = set().union(*(failed for _, failed in expected))
    cells = [f"replay/index.html#circle_crossing_5/test/{case}/{name}" for name, _ in expected for case in shown]
    assert sorted(links) == sorted(
        cells + [f"replay/index.html#circle_crossing_5/test/0/{name}" for name, _ in expected]
    )


def test_a_damaged_entry_is_left_out_and_a_bad_command_leaves_the_others_in_the_replay(root, tmp_path):
    place = tmp_path / "boards/five/entries"
    for name in ("late", "social_force", "orca"):
        shutil.copytree(root / "five/entries" / name, place / name)
    shutil.copy(root / "five/board.toml", tmp_path / "boards/five")
    shutil.copy(root / "shipped.toml", tmp_path / "boards")
    change_rows(place / "late/public.parquet", "command", lambda lists: [[1e3] * len(each) for each in lists])
    (place / "social_force/public.parquet").write_bytes(b"nothing")
    folder = build_site(tmp_path / "boards", tmp_path) / "leaderboards"
    assert "They cannot be simulated again" in (folder / "five/entries/late.html").read_text(encoding="utf-8")
    assert not (folder / "five/entries/social_force.html").exists()
    assert "no table of episodes" in (folder / "five/index.html").read_text(encoding="utf-8")
    data = (folder / "five/replay/data/circle_crossing_5/test-0.js").read_text()
    assert set(json.loads(data.partition(",")[2][:-2])) == {"orca"}
    assert "There is no season yet" in (folder / "index.html").read_text(encoding="utf-8")


def test_the_same_boards_give_the_same_bytes(site, root, tmp_path):
    again = build_site(root, tmp_path) / "leaderboards"
    first = site / "leaderboards"
    contents = [
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (first, again)
    ]
    assert contents[0] == contents[1]


@pytest.mark.nightly
def test_each_scenario_of_the_suite_leads_to_its_replay():
    replays = load_module(ROOT / "docs" / "replays.py")
    files = replays.files()
    for page in replays.LINKING:
        linked = re.findall(
            r"\]\(replay/index\.html#([^)]+)\)", replays.add_links((ROOT / f"docs/{page}.md").read_text())
        )
        assert sorted(link.split("/")[0] for link in linked) == sorted(replays.noticing_page.suite_names())
        for scenario, split, case, planners in (link.split("/") for link in linked):
            data = json.loads(files[f"replay/data/{scenario}/{split}-{case}.js"].decode().partition(",")[2][:-2])
            assert set(data) == set(planners.split(","))


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
