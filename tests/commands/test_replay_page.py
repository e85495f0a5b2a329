"""`crowdbench export --format replay`: the page in headless Chromium, beside the recordings that it is made from."""

import contextlib
import json
import re
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.core.types import Outcome
from crowdbench.export.replay_page import COARSE, PAGE, QUANTUM, export_page
from crowdbench.record.recorded_cases import read_recorded
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_run, load_stored_scenario
from crowdbench.runs.make import make_run
from crowdbench.runs.replay import stored_traces
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases

pytestmark = pytest.mark.slow

RUNS = [
    ("orca", "door_10", 10),
    ("mppi", "door_10", 2),
    ("orca_margin", "streets_16", 1),
    ("orca", "office_8", 1),
]
"""Planner, scenario and number of cases: with attention and predictions, with respawn, with walls that hide people."""

EPISODES = """() => Object.fromEntries(Object.entries(replay.episodes).map(
    ([planner, { canvas, caption, ...episode }]) => [planner, episode]))"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The runs, and the folder of their page."""
    place = tmp_path_factory.mktemp("replay")
    made = []
    for planner, scenario, cases in RUNS:
        folder = place / f"{planner}-{scenario}"
        make_run(load_run(RunSpec(planner, scenario, Cases("val", 0, cases), record="all")), folder)
        made.append(RunResult.read(folder))
    arguments = [*(str(run.directory) for run in made), "--format", "replay", "--out", str(place / "page")]
    done = CliRunner().invoke(app, ["export", *arguments])
    assert done.exit_code == 0, done.output
    assert "12 cases in" in done.output
    return made, place / "page"


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs Chromium")
    with (
        playwright.sync_playwright() as started,
        contextlib.closing(started.chromium.launch(executable_path=chromium)) as one,
    ):
        yield one


@pytest.fixture
def visit(browser, runs):
    """Open the page at a link; afterwards, nothing was on the console and nothing came from elsewhere."""
    wrong, opened = [], []

    def go(link="", width=1280, height=720, **options):
        context = browser.new_context(
            viewport={"width": width, "height": height}, **{"reduced_motion": "reduce"} | options
        )
        opened.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("requestfailed", lambda request: wrong.extend(url_of_failure(request)))
        page.on("request", lambda request: wrong.extend([request.url] * (not is_inside(request.url, runs[1]))))
        page.goto((runs[1] / PAGE).as_uri() + link)
        page.wait_for_function("document.querySelectorAll('figure canvas').length > 0")
        return page

    yield go
    for context in opened:
        context.close()
    assert wrong == []


def url_of_failure(request):
    """The URL of a failed request, unless the page was left or closed before it was answered."""
    return [] if request.failure == "net::ERR_ABORTED" else [request.url]


def is_inside(url, folder):
    return url.startswith((folder.as_uri() + "/", "data:"))


def same(value, other, tolerance=1e-9):
    np.testing.assert_allclose(value, other, atol=tolerance, rtol=0.0)


@pytest.mark.parametrize("number", range(len(RUNS)))
def test_the_page_has_the_positions_of_the_recording_to_the_quantum(runs, visit, number):
    planner, scenario, cases = RUNS[number]
    [trace] = stored_traces(runs[0][number], load_stored_scenario)
    page = visit()
    for case in range(min(cases, 2)):
        page.goto(page.url.partition("#")[0] + f"#any/{scenario}/val/{case}/{planner}@0")
        page.wait_for_function(f"document.title.startsWith('{scenario}, case val/{case}')")
        episode = page.evaluate(EPISODES)[planner]
        states = episode["steps"] + 1
        assert (states - 1, episode["outcome"]) == (trace.steps[case], Outcome(trace.outcome[case]).label[0])
        position = np.full((states, trace.position.shape[2], 2), np.nan)
        flags = {name: np.zeros(position.shape[:2], bool) for name in ("seen", "noticed")}
        for stay in episode["stays"]:
            during = slice(stay["first"], stay["last"] + 1), stay["agent"]
            assert np.isnan(position[during]).all()  # nobody is in two places
            position[during] = np.stack([stay["x"], stay["y"]], axis=1)
            same(trace.radius[case][during], stay["radius"], QUANTUM / 2)
            if stay["agent"]:
                assert len(set(trace.person[case, during[0], stay["agent"] - 1])) == 1
            for name, flag in flags.items():
                flag[during] = stay[name] or False
        same(position, trace.position[case, :states], QUANTUM / 2 + 1e-9)
        same(np.array(episode["gap"]) / 100, np.minimum(trace.gap[case, : states - 1], 1e3), 0.005 + 1e-9)
        present = trace.present[case, :states, 1:]
        assert (flags["seen"][:, 1:] == (trace.seen[case, :states] & present)).all()
        if trace.noticed is not None:
            assert (flags["noticed"][:, 1:] == (trace.noticed[case, :states] & present)).all()
            assert flags["noticed"].any()
        if episode.get("heading"):
            same(np.exp(1j * np.array(episode["heading"])), np.exp(1j * trace.heading[case, :states]), 0.006)
    assert (~flags["seen"][:, 1:] & present).any() == (scenario == "office_8")


def test_predicted_and_considered_paths_are_those_of_the_recording(runs, visit):
    run = runs[0][1]
    recorded = read_recorded(run.directory / "run.rrd", 1).paths(run.rules.dt)
    planned = visit("#suite/door_10/val/1/mppi@2").evaluate(EPISODES)["mppi"]["planned"]
    assert len(planned) == run.episodes.steps[1] + 1
    compared = 0
    for state, paths in enumerate(planned):
        for kind in ("predicted", "considered"):
            lines = getattr(recorded[state], kind) if state in recorded else []
            assert len(paths[kind]) == len(lines)
            for line, path in zip(lines, paths[kind], strict=True):
                compared += 1
                same(line[[0, -1]], np.array(path)[[0, -1]], COARSE / 2 + 1e-6)
    assert compared > 500


def test_a_link_shows_its_frame_and_stays(runs, visit):
    page = visit("#suite/door_10/val/1/mppi,orca@3.25")
    assert page.evaluate("Object.keys(replay.episodes)") == ["mppi", "orca"]
    assert page.locator("#clock").inner_text() == "3.25 s"
    assert page.locator("#time").input_value() == "3.25"
    for number, planner in ((1, "mppi"), (0, "orca")):
        [trace] = stored_traces(runs[0][number], load_stored_scenario)
        label = page.get_by_role("img", name=re.compile(f"^{planner} at 3.25 s")).get_attribute("aria-label")
        assert f"gap {trace.gap[1, 12]:.2f} m" in label
        assert "sees 10 of 10 pedestrians" in label
    assert page.url.endswith("#door_10/val/1/mppi,orca@3.25")
    page.locator("#time").fill("2")
    assert page.url.endswith("#door_10/val/1/mppi,orca@2")
    page.goto(page.url.replace("val/1/mppi,orca@2", "val/0/orca@1"))
    page.wait_for_function("document.title.includes('val/0')")
    assert page.locator("#clock").inner_text() == "1.00 s"


def test_it_plays_to_the_end_and_pauses(visit):
    page = visit("#suite/door_10/val/0/orca", reduced_motion="no-preference")
    page.wait_for_function("document.getElementById('time').value > .5")  # without a time in the link it plays
    page.keyboard.press(" ")
    stopped = page.locator("#time").input_value()
    page.wait_for_timeout(200)
    assert page.locator("#time").input_value() == stopped
    page.locator("#speed").select_option("4")
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("document.querySelector('figcaption .s, figcaption .c, figcaption .t')")
    page.wait_for_function("document.getElementById('play').textContent.includes('Play')")
    assert "orca at" in page.locator("#status").inner_text()


def test_a_failure_has_a_verdict_and_a_button_that_leads_to_it(runs, visit):
    episodes = runs[0][0].episodes
    failed = next(case for case in episodes.failures["collision"] if case > 0)
    page = visit("#suite/door_10/val/0/orca@0")
    page.keyboard.press("f")
    page.wait_for_function(f"document.title.includes('val/{failed} ')")
    end = episodes.steps[failed] * 0.25
    page.keyboard.press("j")
    page.keyboard.press(" ")
    assert end - 3 <= float(page.locator("#time").input_value()) < end
    page.keyboard.press("End")
    assert page.locator("figcaption .c").inner_text() == f"✗ collision, {end:.2f} s"
    assert f"at {end:g} s" in page.locator(".verdict").inner_text()


def test_outcomes_are_hidden_until_an_episode_has_been_played(runs, visit):
    failed = runs[0][0].episodes.failures["collision"][0]
    page = visit(f"#suite/door_10/val/{failed}/orca@1")
    body, verdict = page.locator("body"), page.locator(".verdict")
    assert not re.search("[✓✗◷]", body.inner_text())
    assert verdict.inner_text() == "orca: the verdict follows at the end."
    page.keyboard.press("End")
    assert verdict.inner_text().startswith("orca: Collision with ")
    assert page.locator("#case option:checked").inner_text() == f"val/{failed} ✗"
    assert len(re.findall("✗", page.locator("#planners").inner_text())) == 1
    page.keyboard.press("Home")
    assert "✗" in page.locator("#planners").inner_text()
    page.get_by_role("button", name="All outcomes").click()
    assert "✓" in page.locator("#case").inner_text()


def test_the_keyboard_reaches_each_control_and_keeps_its_place(visit):
    page = visit("#suite/door_10/val/1/mppi,orca@1")
    reached = []
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement === document.body"):
            break
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.textContent.trim()"))
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    assert reached[-1] == "Keys"
    assert {"scenario", "previous", "case", "next", "failure", "outcomes", "play", "time", "speed"} <= {*reached}
    page.get_by_role("button", name="mppi").focus()
    page.keyboard.press("Enter")
    page.wait_for_function("document.querySelectorAll('figure').length === 1")
    assert page.evaluate("document.activeElement.textContent.trim()") == "mppi"
    page.keyboard.press("Enter")
    page.wait_for_function("document.querySelectorAll('figure').length === 2")


def test_a_page_leads_back(runs, tmp_path, visit):
    page = visit()
    assert page.locator("#back").inner_text() == ""
    export_page(runs[0][3:], load_stored_scenario, tmp_path, back=("../suite.html", "The suite"))
    page.route("**/data/index.js", lambda route: route.fulfill(path=tmp_path / "data" / "index.js"))
    page.reload()
    page.wait_for_function("document.querySelectorAll('figure canvas').length > 0")
    assert page.get_by_role("link", name="The suite").get_attribute("href") == "../suite.html"


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 720)])
def test_the_page_fits_and_each_control_has_a_name(visit, width, height, theme):
    page = visit("#suite/door_10/val/1/mppi,orca@3", width, height, color_scheme=theme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if width == 1280:
        assert page.evaluate("document.documentElement.scrollHeight") <= height
    unnamed = [
        control.evaluate("each => each.outerHTML")
        for control in page.locator("button, select, input, canvas[role=img]").all()
        if not re.search('"[^"]+"', control.aria_snapshot())
    ]
    assert unnamed == []
    ground, most = page.evaluate("""() => {
        const canvas = document.querySelector('figure canvas'), pen = canvas.getContext('2d');
        const pixels = pen.getImageData(0, 0, canvas.width, canvas.height).data;
        return [pixels[0], new Set(new Uint32Array(pixels.buffer)).size];
    }""")
    assert (ground > 127) == (theme == "light")
    assert most > 20
    before = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    page.get_by_role("button", name="Switch between light and dark").click()
    assert page.evaluate("getComputedStyle(document.documentElement).backgroundColor") != before


def test_the_page_and_its_data_are_small(runs):
    folder = runs[1]
    assert sum(path.stat().st_size for path in folder.iterdir() if path.is_file()) < 60_000
    for path in folder.glob("data/door_10/*[0-9].js"):
        episodes = json.loads(path.read_text().partition(",")[2][:-2])
        assert path.stat().st_size / len(episodes) < 5_000
    assert not re.search(r"https?://", "".join(path.read_text() for path in folder.iterdir() if path.is_file()))


def test_runs_that_cannot_share_a_page_are_refused(runs, tmp_path, call):
    first, *others = [str(run.directory) for run in runs[0]]
    done = call("export", first, others[0], "--out", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "--format txt takes one run, and 2 are given" in done.stderr
    spec = RunSpec("orca", "door_10", Cases("val", 0, 1), overrides={"pedestrians.attention.ignores": 0.5})
    make_run(load_run(spec), tmp_path / "other")
    done = call("export", first, str(tmp_path / "other"), "--format", "replay", "--out", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "has another scenario door_10 than runs before it" in done.stderr
    assert not (tmp_path / "out").exists()
