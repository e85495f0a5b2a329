"""The game on the start page: its rules in JavaScript beside the simulator, and its data."""

import contextlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Outcome
from crowdbench.metrics.score import score
from crowdbench.planners.driver import Driver
from crowdbench.results.run_result import RunResult
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

DOCS = Path(__file__).parents[2] / "docs"
CASES = sorted((DOCS / "cross/cases").glob("[0-9]*.js"), key=lambda path: int(path.stem))
DRIVES = 7
"""Command sequences of each case, 210 in all."""


def read(path):
    """The data of a case."""
    return json.loads(path.read_text().removeprefix("cross.take(").rstrip().removesuffix(")"))


def sequences(scene, rng):
    """Commands as people give them: four that wander and pause on their way, two that wait aside, one that flees."""
    steps, start = scene["steps"], np.array(scene["start"])
    towards = np.array(scene["goal"]) - start
    for spread in (0.0, 0.3, 0.6, 0.9):
        heading = np.arctan2(towards[1], towards[0]) + np.repeat(rng.normal(0, spread, steps // 4 + 1), 4)[:steps]
        speed = np.repeat(rng.choice([0.0, 0.5, 1.0], steps // 4 + 1, p=[0.2, 0.2, 0.6]), 4)[:steps]
        yield rounded(speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1))
    aside = 0.95 * start / np.linalg.norm(start)
    for pause in (int(rng.integers(5, 30)), 45):
        flight = rounded(np.repeat([aside, [0.0, 0.0]], [8, pause], axis=0))
        back = np.array(scene["goal"]) - start - 0.25 * flight.sum(axis=0)
        yield np.concatenate([flight, np.tile(rounded(0.98 * back / np.linalg.norm(back)), (steps - len(flight), 1))])
    yield np.tile(rounded(aside), (steps, 1))


def rounded(commands):
    """Commands in the steps that a link can have."""
    return np.trunc(commands * 200) / 200


@pytest.fixture(scope="module")
def compared():
    """Outcome, steps and score of each drive: in the simulator, and on the page."""
    if shutil.which("node") is None:
        pytest.skip("needs node")
    rng, scenes = np.random.default_rng(7), [read(path) for path in CASES]
    drives = [list(sequences(scene, rng)) for scene in scenes]
    scenario, cases = load_scenario("circle_20_blind"), Cases("val", 0, len(scenes))
    simulated, attempts = [], []
    for number in range(DRIVES):
        commands = np.zeros((len(scenes), scenario.rules.max_steps, 2))
        for row, of_case in enumerate(drives):
            commands[row, : len(of_case[number])] = of_case[number]
            attempts.append([CASES[row].stem, of_case[number].tolist()])
        trace = rollout(Driver(Playback(commands), "of the test"), scenario, cases)
        labels = ["timeout" if o == Outcome.TIMEOUT else Outcome(int(o)).label for o in trace.outcome]
        simulated += zip(labels, trace.steps.tolist(), score(trace).tolist(), strict=True)
    asked = json.dumps({"cases": {path.stem: str(path) for path in CASES}, "attempts": attempts})
    script = Path(__file__).parents[1] / "cross_outcomes.js"
    done = subprocess.run(["node", script], input=asked, capture_output=True, text=True, check=True)
    return simulated, json.loads(done.stdout)


@pytest.mark.slow
def test_contact_and_arrival_are_those_of_the_simulator(compared):
    simulated, played = compared
    assert len(simulated) >= 200
    assert [each[:2] for each in map(tuple, played)] == [each[:2] for each in simulated]
    outcomes = [outcome for outcome, *_ in simulated]
    assert min(map(outcomes.count, ("success", "collision", "timeout"))) >= 10


@pytest.mark.slow
def test_the_score_is_that_of_the_simulator(compared):
    simulated, played = compared
    assert np.allclose([each[2] for each in played], [each[2] for each in simulated], atol=1e-4)


def test_the_page_and_its_first_case_have_at_most_200_kilobytes():
    code = [*(DOCS / "cross").glob("*.*"), DOCS / "cross/cases/index.js"]
    assert sum(path.stat().st_size for path in code) + max(path.stat().st_size for path in CASES) < 200_000


def test_each_case_has_all_planners_that_measure():
    names = {tuple(planner["name"] for planner in read(path)["planners"]) for path in CASES}
    assert len(names) == 1
    about = json.loads((DOCS / "cross/cases/index.js").read_text().split("=", 1)[1].rstrip().rstrip(";"))
    hit = [sum(planner["outcome"] == "collision" for planner in read(path)["planners"]) for path in CASES]
    assert about["collided"] == hit


@pytest.fixture(scope="module")
def game(tmp_path_factory):
    """Opens the game of the start page in headless Chromium on a phone; afterwards nothing was on the console."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs Chromium")
    folder, page = tmp_path_factory.mktemp("game"), (DOCS / "index.md").read_text()
    html = page[page.index("<link") : page.rindex("</script>") + len("</script>")]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head += '<body class="md-typeset" style="margin: 0; padding: 0 .8rem">'
    (folder / "index.html").write_text(f"<!doctype html>{head}{html}")
    shutil.copytree(DOCS / "cross", folder / "cross")
    wrong = []
    with (
        playwright.sync_playwright() as started,
        contextlib.closing(started.chromium.launch(executable_path=chromium)) as browser,
    ):
        context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)

        def visit(link=""):
            one = context.new_page()
            one.on("console", lambda message: wrong.append(message.text))
            one.on("pageerror", lambda error: wrong.append(str(error)))
            one.goto((folder / "index.html").as_uri() + link)
            one.wait_for_function("document.querySelectorAll('[data-cross=list] li').length > 20")
            return one

        yield visit
    assert wrong == []


def drive_up(page):
    """Drive towards the goal by the keyboard alone, until the end."""
    page.locator("[data-cross=canvas]").focus()
    page.keyboard.press("Enter")
    page.wait_for_function("document.getElementById('cross').dataset.phase === 'drive'")
    page.keyboard.down("ArrowUp")
    page.wait_for_function("document.getElementById('cross').dataset.phase === 'over'", timeout=60_000)


@pytest.mark.slow
def test_a_drive_by_keyboard_ends_with_an_outcome_a_link_and_a_file(game, call, tmp_path):
    page = game("#val/0")
    drive_up(page)
    verdict = page.locator("[data-cross=verdict]").inner_text()
    assert verdict.startswith("You ")
    assert " of 23 planners" in page.locator("[data-cross=score]").inner_text()
    assert page.url.partition("#")[2].startswith("val/0/")
    with page.expect_download() as download:
        page.locator("[data-cross=download]").click()
    file = tmp_path / "attempt.json"
    download.value.save_as(file)
    done = call("score", str(file), "--json")
    assert done.returncode == 0, done.stderr
    (episode,) = json.loads(done.stdout)["episodes"]
    assert episode["outcome"] == {"You cr": "success", "You co": "collision", "You ra": "timeout"}[verdict[:6]]
    again = game(f"#{page.url.partition('#')[2]}")
    assert "Can you do better?" in again.locator("[data-cross=lead]").inner_text()


@pytest.mark.slow
def test_a_frame_takes_at_most_four_milliseconds_and_the_page_does_not_slide_sideways(game):
    page = game("#val/1")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.evaluate("""() => {
        window.spent = [];
        const request = requestAnimationFrame;
        window.requestAnimationFrame = act => request(now => {
            const begin = performance.now();
            act(now);
            spent.push(performance.now() - begin);
        });
    }""")
    page.locator("[data-cross=sensing]").check()
    drive_up(page)
    spent = page.evaluate("spent")
    assert len(spent) > 60
    assert np.median(spent) < 4.0


ATTEMPT = {"planner": "human", "scenario": "circle_20_blind", "case": "val/3", "commands": [[0.0, 0.5], [0.2, 0.9]]}


def test_score_writes_an_attempt_as_a_run_that_tables_read(call, tmp_path):
    (tmp_path / "attempt.json").write_text(json.dumps(ATTEMPT))
    done = call("score", str(tmp_path / "attempt.json"), "--out", str(tmp_path / "human"))
    assert done.returncode == 0, done.stderr
    assert "human on circle_20_blind" in done.stdout
    run = RunResult.read(tmp_path / "human")
    assert (run.label, str(run.cases)) == ("human", "val:3:4")
    assert run.commands.of(3)[:2].tolist() == ATTEMPT["commands"]


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"commands": [[0.0, 5.0]]}, "asked for 5 m/s, but the vehicle's maximum is 1 m/s"),
        ({"commands": [[0.0]]}, "each of the commands must have two numbers"),
        ({"commands": []}, "commands is [], but must be a list of commands, two numbers each"),
        ({"case": "3 of 30"}, "case '3 of 30' is not the name of a case"),
        ({"scenario": "nowhere"}, "nowhere"),
        ({"speed": 1}, "unknown key speed"),
    ],
)
def test_score_refuses_a_file_that_is_no_attempt_in_a_sentence(call, tmp_path, wrong, reason):
    (tmp_path / "attempt.json").write_text(json.dumps(ATTEMPT | wrong))
    done = call("score", str(tmp_path / "attempt.json"))
    assert done.returncode != 0
    assert reason in done.stderr


@pytest.mark.parametrize("text", ["[1]", "[", "null"])
def test_score_refuses_a_file_that_is_no_table(call, tmp_path, text):
    (tmp_path / "attempt.json").write_text(text)
    done = call("score", str(tmp_path / "attempt.json"))
    assert done.returncode != 0
    assert "attempt.json is no" in done.stderr
