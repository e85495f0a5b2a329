"""`crowdbench render`: cases from above, as pictures, strips and films."""

import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from helpers import fixture, stored_trace
from PIL import Image
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import app
from crowdbench.core.types import Outcome
from crowdbench.drawing import APART, CIRCLE, LIGHT, MEASURED, Disc, Line, Moment, Polygon, Text, draw_moment
from crowdbench.figures import episode_figure
from crowdbench.figures.episode_figure import FILMS, HOLD, RATE, SIDE, Episode
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.record.explanation import describe_failure
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError


class Sideways(Planner):
    """Drives into the wall beside it."""

    def plan(self, obs):
        return np.tile([1.0, 0.0], (len(obs), 1))


def words(figure):
    """The texts of an SVG."""
    return re.findall(r"<text[^>]*>([^<]+)</text>", figure.read_text())


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A run with two recorded cases, in which the vehicle hits somebody."""
    out = tmp_path_factory.mktemp("driven") / "run"
    given = ["--planner", "straight", "--cases", "2", "--record", "all", "--out", str(out)]
    assert CliRunner().invoke(app, ["run", *given]).exit_code == 0
    return out


def test_a_case_is_drawn_with_the_times_along_its_way(driven, tmp_path):
    assert (
        CliRunner().invoke(app, ["render", str(driven), "--case", "1", "--out", str(tmp_path / "a.svg")]).exit_code == 0
    )
    assert {"0 s", "2 s", "1 m"} <= set(words(tmp_path / "a.svg"))


def test_a_vehicle_that_has_hit_an_obstacle_has_the_mark_of_a_contact():
    scenario = load_scenario("street_8", {"pedestrians.number": 1})
    trace = rollout(Driver(Sideways(), "sideways"), scenario, Cases("test", 0, 1))
    assert trace.outcome[0] == Outcome.WALL_COLLISION
    end = int(trace.steps[0])

    def colors(state):
        shapes = draw_moment(Moment.of_trace(trace, 0, state))
        return [shape.edge for shape in shapes if isinstance(shape, Disc | Polygon)]

    assert LIGHT.contact in colors(end)
    assert LIGHT.contact not in colors(end - 1)


@pytest.mark.parametrize(("scenario", "number"), [(fixture("noise_late"), 1), ("circle_crossing_5", 0)])
def test_measured_positions_are_rings_with_a_key_where_they_differ(tmp_path, scenario, number):
    run = tmp_path / "run"
    given = ["run", "--planner", "orca", "--scenario", scenario, "--cases", "val:1", "--out", str(run)]
    assert CliRunner().invoke(app, given).exit_code == 0
    trace = stored_trace(run)
    state = int(trace.steps[0])
    shapes = [shape for shape in draw_moment(Moment.of_trace(trace, 0, state)) if isinstance(shape, Line)]
    rings = [shape.points for shape in shapes if len(shape.points) == len(CIRCLE) and shape.color == LIGHT.text]
    if number:
        where = trace.perceived[0, state]
        centres = where[np.isfinite(where[:, 0]) & (np.hypot(*(where - trace.position[0, state, 1:]).T) > APART)]
        np.testing.assert_allclose([ring[:-1].mean(axis=0) for ring in rings], centres, atol=1e-9)
        assert len(rings) > 2
    else:
        assert rings == []
    for more in ([], ["--strip", "4"]):
        given = ["render", str(run), "--case", "0", "--out", str(tmp_path / "a.svg"), *more]
        assert CliRunner().invoke(app, given).exit_code == 0
        assert words(tmp_path / "a.svg").count(MEASURED) == number


def test_a_picture_shows_what_is_around_the_vehicle(driven, tmp_path):
    episode = Episode(stored_trace(driven), 1, zoom=4.0)
    way = episode.trace.position[1, : episode.end + 1, 0]
    np.testing.assert_allclose(episode.bounds(way[3]), [way[3] - 2.0, way[3] + 2.0])
    np.testing.assert_allclose(episode.bounds(), [way.min(axis=0) - 2.0, way.max(axis=0) + 2.0])
    given = ["render", str(driven), "--case", "1", "--zoom", "4", "--strip", "2", "--out", str(tmp_path / "a.svg")]
    assert CliRunner().invoke(app, given).exit_code == 0
    refused = CliRunner().invoke(app, ["render", "corner_5", "--case", "3", "--zoom", "4"])
    assert "--zoom is for a case of a run" in str(refused.exception)


def test_a_scenario_is_drawn_before_anything_is_run(tmp_path):
    out = tmp_path / "a.svg"
    assert CliRunner().invoke(app, ["render", "corner_5", "--case", "3", "--out", str(out)]).exit_code == 0
    assert words(out) == ["1 m"]
    first = out.read_bytes()
    CliRunner().invoke(app, ["render", "corner_5", "--case", "4", "--out", str(out)])
    assert out.read_bytes() != first


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["corner_5", "--strip", "3"], "a scenario has its start alone"),
        (["eth_recorded"], "give the folder that holds them"),
    ],
)
def test_a_start_that_cannot_be_drawn_gets_one_sentence(arguments, sentence, tmp_path):
    given = ["render", *arguments, "--case", "1", "--out", str(tmp_path / "a.svg")]
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, given).exception


def test_a_strip_shows_moments_up_to_the_end(driven, tmp_path):
    given = ["render", str(driven), "--case", "1", "--strip", "3", "--out", str(tmp_path / "a.svg")]
    assert CliRunner().invoke(app, given).exit_code == 0
    times = [float(found[1]) for word in words(tmp_path / "a.svg") if (found := re.search(r"([\d.]+) s$", word))]
    assert len(times) == 3
    assert times[0] < times[1] < times[2]


@pytest.mark.parametrize("suffix", ["gif", pytest.param("webp", marks=pytest.mark.slow)])
def test_a_film_has_20_pictures_a_second_and_ends_with_the_contact(suffix, driven, tmp_path):
    film = tmp_path / f"a.{suffix}"
    assert CliRunner().invoke(app, ["render", str(driven), "--case", "1", "--out", str(film)]).exit_code == 0
    trace = stored_trace(driven)
    with Image.open(film) as shown:
        shown.seek(shown.n_frames - 1)
        shown.load()
        duration = shown.info["duration"]
        last = np.asarray(shown.convert("RGB"), int)
        # Pictures that are equal, at the end, may be one that is shown for longer.
        assert shown.n_frames >= 20 * trace.rules.dt * int(trace.steps[1])
    assert duration >= 50
    assert (np.abs(last - LIGHT.contact).sum(axis=2) < 60).any()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_a_film_for_talks_has_all_pictures_in_their_colours(driven, tmp_path):
    film = tmp_path / "a.mp4"
    assert CliRunner().invoke(app, ["render", str(driven), "--case", "1", "--out", str(film)]).exit_code == 0
    episode = Episode(stored_trace(driven), 1)
    last = episode_figure._frame([episode], float(episode.end), FILMS[".mp4"])
    width, height = (2 * math.ceil(side / 2) for side in last.size)
    decode = ["ffmpeg", "-loglevel", "error", "-i", str(film), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    content = subprocess.run(decode, check=True, stdout=subprocess.PIPE).stdout
    pictures = np.frombuffer(content, np.uint8).reshape(-1, height, width, 3)
    assert len(pictures) == math.ceil(RATE * episode.trace.rules.dt * episode.end) + HOLD
    assert np.abs(pictures[-1, : last.height, : last.width] - np.asarray(last, float)).mean() < 2.0
    assert pictures[-1, -FILMS[".mp4"] // 20 :].min() > 245  # the rim


def test_a_film_ends_with_the_verdict_that_the_terminal_prints(driven):
    episode = Episode(stored_trace(driven), 1)
    sentence = describe_failure(episode.trace, 1)[0]

    def said(step):
        shapes, *_ = episode_figure._add_verdict(episode, step, 3)
        return " ".join(shape.text for shape in shapes if isinstance(shape, Text))

    assert " ".join(episode.verdict) == sentence
    assert sentence in said(float(episode.end))
    assert sentence not in said(episode.end - 1.0)


@pytest.mark.slow
def test_several_runs_are_drawn_side_by_side(driven, tmp_path):
    other = tmp_path / "orca"
    given = ["--planner", "orca", "--cases", "2", "--record", "all", "--out", str(other)]
    assert CliRunner().invoke(app, ["run", *given]).exit_code == 0
    runs, figure, film = [str(driven), str(other)], tmp_path / "a.svg", tmp_path / "a.gif"
    for out in (figure, film):
        assert CliRunner().invoke(app, ["render", *runs, "--case", "1", "--out", str(out)]).exit_code == 0
    said = words(figure)
    assert [word for word in said if word in ("orca", "straight")] == ["straight", "orca"]
    for run in (driven, other):
        trace = stored_trace(run)
        mark = "\N{CHECK MARK}" if trace.outcome[1] == Outcome.SUCCESS else "\N{BALLOT X}"
        assert [word for word in said if word[0] == mark and word.endswith(f" {trace.steps[1] * trace.rules.dt:g} s")]
    assert said.count("1 m") == 2
    with Image.open(film) as shown:
        assert shown.width > SIDE * FILMS[".gif"]
    elsewhere = ["--planner", "orca", "--cases", "2", "--set", "pedestrians.number=3", "--record", "all"]
    assert CliRunner().invoke(app, ["run", *elsewhere, "--out", str(tmp_path / "three")]).exit_code == 0
    for more, sentence in (
        ([str(tmp_path / "three")], "case 1 starts differently in"),
        (["street_8"], "are not all runs"),
        ([str(other), "--strip", "3"], "--strip draws a figure of one run"),
    ):
        with pytest.raises(InputError, match=sentence):
            raise CliRunner().invoke(app, ["render", str(driven), *more, "--case", "1"]).exception


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--case", "7"], "case 7 is none of the cases test:0:2 of"),
        (["--case", "1", "--out", "a.avi"], "with the ending .pdf, .png, .svg, .gif, .webp or .mp4, not a.avi"),
        (["--case", "1", "--out", "a.mp4"], "needs the program ffmpeg"),
    ],
)
def test_a_case_that_cannot_be_drawn_gets_one_sentence(arguments, sentence, driven, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["render", str(driven), *arguments]).exception
    assert not list(tmp_path.iterdir())
