import contextlib
import dataclasses
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from helpers import drive, trace
from rerun.chunk import RrdReader

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Outcome
from crowdbench.metrics.fault import find_contacts
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.record import viewer
from crowdbench.record.blueprint import draw_logs
from crowdbench.record.decisions import draw_decisions
from crowdbench.record.marks import draw_approach, time_to_closest
from crowdbench.record.recorded_cases import read_recorded, recorded_outcomes
from crowdbench.record.write import Recorder
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, Interrupted

RUN = {"planner": "orca", "scenario": "circle_crossing_5", "scenario_digest": "abc"}


def write(path, *traces, rows=None):
    with Recorder(path, **RUN) as recorder:
        for one in traces:
            recorder.add(one, np.arange(len(one)) if rows is None else rows, {"path_length": np.full(len(one), 1.5)})
    return path


def line(steps, pedestrians, outcome=Outcome.SUCCESS, **more):
    """The vehicle drives up, the pedestrians walk beside it; irrational numbers, so that rounding would show."""
    time = np.arange(steps + 1)[:, None, None] * np.sqrt(0.05)
    return trace(time * [0.0, 1.0] + np.arange(pedestrians + 1)[:, None] * [np.pi / 3, 0.0], outcome, **more)


@pytest.fixture(scope="module")
def driven():
    return drive("orca", "12")


@pytest.fixture(scope="module")
def recorded(driven, tmp_path_factory):
    return write(tmp_path_factory.mktemp("run") / "run.rrd", driven)


def test_episodes_of_several_batches_and_crowds_are_listed_by_case(driven, tmp_path):
    other = line(3, 0, gap=[np.inf] * 3)
    nothing_moves = trace(np.zeros((3, 1, 2)), Outcome.TIMEOUT, gap=[np.inf] * 2)
    others = [dataclasses.replace(each, case=np.array([20 + n])) for n, each in enumerate((other, nothing_moves))]
    path = tmp_path / "run.rrd"
    with Recorder(path, **RUN) as recorder:
        recorder.add(driven, np.array([7, 2]), {})
        for each in others:
            recorder.add(each, np.array([0]), {})
    outcomes = {case: Outcome(int(driven.outcome[case])).label for case in (2, 7)}
    assert recorded_outcomes(path) == {**outcomes, 20: "success", 21: "timeout"}


def test_a_copy_of_a_recording_has_the_same_episodes_and_layout(driven, tmp_path):
    one, parts = write(tmp_path / "one.rrd", driven), []
    for name, rows in (("a.rrd", np.arange(5)), ("b.rrd", np.arange(5, 12))):
        parts.append(write(tmp_path / name, driven, rows=rows))
    joined = tmp_path / "joined.rrd"
    with Recorder(joined, **RUN) as recorder:
        assert [recorder.copy(part) for part in parts] == [5, 7]
    assert recorded_outcomes(joined) == recorded_outcomes(one)
    assert read_recorded(joined, 7).properties == read_recorded(one, 7).properties


def test_all_that_a_planner_logs_can_be_recorded(tmp_path):
    class Talker(Planner):
        def plan(self, obs):
            obs.log("confidence", np.ones(len(obs)))
            obs.log("aim", np.zeros((len(obs), 2)))
            obs.log("points", obs.pedestrians.position)
            obs.log("futures", np.zeros((len(obs), 3, 8, 5, 2)))
            obs.log("values", np.zeros((len(obs), 81)))
            return np.zeros((len(obs), 2))

    driver, scenario = Driver(Talker(), "talker", 60.0), load_scenario("circle_crossing_5", {})
    talked = rollout(driver, scenario, Cases.parse("2"), keep_logs=True)
    assert len(recorded_outcomes(write(tmp_path / "run.rrd", talked))) == 2


def test_what_is_logged_now_and_then_is_drawn_without_the_gaps(driven):
    now_and_then = np.arange(driven.gap.shape[1]) % 8 == 0
    shapes = {"curve": (), "points": (5, 2), "lines": (8, 5, 2)}
    logs = {name: np.full((*driven.gap.shape, *shape), np.nan) for name, shape in shapes.items()}
    for values in logs.values():
        values[:, now_and_then] = 1.0
    logs["never"] = np.full(driven.gap.shape, np.nan)
    said = dataclasses.replace(driven, logs=logs)
    chunks = [*draw_logs(said, 0), *draw_decisions(said, 0)]
    moving = {chunk.entity_path: chunk.to_record_batch() for chunk in chunks if not chunk.is_static}
    asked, steps = list(range(0, int(driven.steps[0]), 8)), list(range(int(driven.steps[0])))
    shown = {path: (batch.column("time").cast("int64").to_numpy() / 0.25e9).tolist() for path, batch in moving.items()}
    assert shown == {
        "/plots/planner/curve": asked,
        "/world/planner/points": asked,
        "/world/planner/predicted/lines/0": steps,
        "/world/planner/predicted/lines/1": steps,
        "/world/planner/predicted/lines/2": steps,
    }


def test_futures_are_shorter_as_they_come_true(driven):
    """Of a future of 8 steps that is logged every 8th step, each step shows what is still to come."""
    way = np.full((*driven.gap.shape, 8, 1, 2), np.nan)
    way[:, ::8] = np.arange(8.0)[:, None, None]
    said = dataclasses.replace(driven, logs={"way": way})
    moving = [chunk.to_record_batch() for chunk in draw_decisions(said, 0) if not chunk.is_static]
    strips = [batch.column("LineStrips2D:strips").to_pylist() for batch in moving]
    first = [min((x for strip in third[k] for x, _ in strip), default=np.inf) for k in range(8) for third in strips]
    assert np.min(np.reshape(first, (8, 3)), axis=1).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, np.inf]


def test_the_closest_approach_ahead_is_shown():
    """The vehicle drives up at 1 m/s, past a pedestrian that stands 1 m beside its path, 1.5 or 3 m ahead."""
    position, velocity = np.array([[3.0, 3.0]]), np.array([[-2.0, -3.0]])
    when = time_to_closest(position, velocity)[0]
    assert when == pytest.approx((6.0 + 9.0) / 13.0)
    assert np.linalg.norm(position + when * velocity) <= np.linalg.norm(position + (when + 0.01) * velocity)
    assert time_to_closest(position, -velocity)[0] == 0.0
    steps = 4
    far = trace(np.array([[[0.0, 0.25 * t], [1.0, 3.0]] for t in range(steps + 1)]), Outcome.SUCCESS)
    far.velocity[0, :, 0] = [0.0, 1.0]
    assert list(draw_approach(far, 0, 0.5)) == []  # it is 2 s ahead at the end
    still = trace(np.array([[[0.0, 0.25 * t], [1.0, 1.5]] for t in range(steps + 1)]), Outcome.SUCCESS)
    still.velocity[0, :, 0] = [0.0, 1.0]
    moving = [chunk.to_record_batch() for chunk in draw_approach(still, 0, 0.5) if not chunk.is_static]
    labels = [text[0] for text in moving[0].column("Points2D:labels").to_pylist()]
    assert labels[0] == "0.40 m in 1.5 s"
    hit = dataclasses.replace(still, outcome=np.array([Outcome.COLLISION]))
    (without_last,) = [chunk.to_record_batch() for chunk in draw_approach(hit, 0, 0.5) if not chunk.is_static]
    shown = [len(text) for text in without_last.column("Points2D:labels").to_pylist()]
    assert shown == [1] * steps + [0]


def test_the_best_command_is_marked(driven):
    fan = np.full((*driven.gap.shape, 4, 3), np.nan)
    fan[:, :] = [[1.0, 0.0, 0.3], [0.0, 1.0, 0.9], [-1.0, 0.0, -np.inf], [0.0, -1.0, 0.6]]
    said = dataclasses.replace(driven, logs={"commands": fan})
    moving = {chunk.entity_path: chunk for chunk in draw_decisions(said, 0) if not chunk.is_static}
    arrows = moving["/world/planner/commands"].to_record_batch().column("Arrows2D:vectors").to_pylist()
    best = moving["/world/planner/commands/best"].to_record_batch().column("Arrows2D:vectors").to_pylist()
    assert arrows[0] == [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    assert best[0] == [[0.0, 1.0]]


def test_an_error_leaves_nothing_behind(driven, tmp_path):
    with pytest.raises(IndexError), Recorder(tmp_path / "run.rrd", **RUN) as recorder:
        recorder.add(driven, np.array([0, 1, 99]), {})
    assert not list(tmp_path.iterdir())


def test_a_finished_recording_stands_alone_and_rerun_finds_it_sound(recorded):
    assert [file.name for file in recorded.parent.iterdir()] == ["run.rrd"]
    subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", "verify", recorded], check=True, capture_output=True)


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99, -1])
def test_a_truncated_recording_is_refused_in_a_sentence(recorded, tmp_path, keep):
    whole = recorded.read_bytes()
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(whole[: int(len(whole) * keep) if isinstance(keep, float) else keep])
    with pytest.raises(InputError, match=r"cut\.rrd is cut short, damaged or no Rerun file"):
        read_recorded(cut, 1)


def test_other_files_are_refused_in_a_sentence(tmp_path):
    text, foreign = tmp_path / "notes.rrd", tmp_path / "foreign.rrd"
    text.write_text("these are no episodes\n" * 50)
    with rr.RecordingStream("another_app") as stream:
        stream.save(foreign)
        stream.log("points", rr.Points2D([[1, 2]]))
    stream.disconnect()
    for path, sentence in (
        (text, "no Rerun file"),
        (foreign, "no episodes of crowdbench"),
        (tmp_path / "x", "there is no"),
    ):
        with pytest.raises(InputError, match=sentence):
            recorded_outcomes(path)


def test_one_case_is_shown_alone(recorded, tmp_path, monkeypatch):
    shown = []

    def started(command, **_):
        if "rrd" in command:
            return run(command, **_)
        shown.append([*recorded_outcomes(Path(command[-1]))])
        return subprocess.CompletedProcess(command, 0)

    run = subprocess.run
    monkeypatch.setattr(viewer.subprocess, "run", started)
    monkeypatch.setenv("DISPLAY", ":0")
    viewer.view(recorded, 7)
    viewer.view(recorded)
    assert shown == [[7], list(range(12))]


@pytest.fixture
def viewer_program(tmp_path, monkeypatch):
    """Replaces Rerun's program by a script, and returns the file with its arguments."""

    def replace(script):
        program = tmp_path / "rerun"
        program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/arguments\n{script}\n')
        program.chmod(0o755)
        monkeypatch.setenv("RERUN_CLI_PATH", str(program))
        return tmp_path / "arguments"

    return replace


def test_a_viewer_that_fails_is_told_in_a_sentence(recorded, viewer_program, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    viewer_program("echo 'Error: a server: no memory' >&2; exit 1")
    with pytest.raises(InputError, match=r"the Rerun viewer failed on .*\.rrd \(no memory\)$"):
        viewer.show(recorded, web=True)
    with pytest.raises(InputError, match=r"\(no memory\): it needs a display with a graphics driver, or --web$"):
        viewer.show(recorded)
    viewer_program("kill -9 $$")
    with pytest.raises(InputError, match=r"the Rerun viewer failed on .*\.rrd"):
        viewer.show(recorded, web=True)
    monkeypatch.setenv("RERUN_CLI_PATH", "/nowhere")
    with pytest.raises(InputError, match=r"failed on .*\.rrd \(Could not find rerun binary at /nowhere\)"):
        viewer.show(recorded, web=True)


def test_a_viewer_in_a_browser_takes_other_ports_if_its_usual_ones_are_taken(recorded, viewer_program, capsys):
    arguments = viewer_program("exit 0")
    with contextlib.ExitStack() as stack:
        for port in (viewer.PORT, viewer.WEB_PORT):
            with contextlib.suppress(OSError):  # another program has it
                taken = stack.enter_context(socket.socket())
                taken.bind(("127.0.0.1", port))
                taken.listen()
        viewer.show(recorded, web=True)
    port, page = map(int, re.findall(r"port (\d+)", arguments.read_text()))
    assert not {port, page} & {viewer.PORT, viewer.WEB_PORT}
    said = capsys.readouterr().err
    assert f"http://127.0.0.1:{page}?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy" in said


def test_the_program_of_rerun_exits_with_its_own_status(recorded):
    command = viewer._command(recorded, viewer._free_port(0), ["--no-such-option"])
    done = subprocess.run(command, capture_output=True, timeout=60)
    assert done.returncode == 2


def test_ctrl_c_closes_a_viewer_without_a_word(recorded, monkeypatch):
    def wait(command, **_):
        raise Interrupted

    monkeypatch.setattr(viewer.subprocess, "run", wait)
    viewer.show(recorded, web=True)


def test_the_ending_names_whom_the_vehicle_hits(tmp_path):
    hit = line(4, 3, Outcome.COLLISION, gap=[1, 1, 1, -0.1])
    hit.position[0, :, 2] = hit.position[0, :, 0] + [0.5, 0.0]
    assert find_contacts(hit).agent[0] == 2


def test_without_a_display_a_picture_is_offered(recorded, monkeypatch):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="no display for a window: use --web, or draw a case with `crowdbench render`"):
        viewer.view(recorded)


@pytest.mark.slow
def test_a_table_of_many_recordings_shows_what_each_is_of(driven, tmp_path):
    one, other = tmp_path / "one.rrd", tmp_path / "other.rrd"
    for path, identity in ((one, "aaaa"), (other, "bbbb")):
        with Recorder(path, **RUN, options={"margin": 0.1}, identity=identity) as recorder:
            recorder.add(driven, np.arange(3), {"jerk": np.arange(len(driven)) * 0.5})
    pytest.importorskip("datafusion")
    with rr.server.Server(host="127.0.0.1", datasets={"runs": [one, other]}) as server:
        dataset = server.client().get_dataset("runs")
        table = dataset.segment_table().to_pandas()
        states = dataset.filter_contents(["/world/agents"]).reader(index="time").to_pandas()
    assert len(table) == len(set(table["rerun_segment_id"])) == 6
    about = {name.removeprefix("property:crowdbench:"): table[name].str[0] for name in table if "crowdbench" in name}
    assert set(about["planner"]) == {"orca"}
    assert set(about["options"]) == {'{"margin": 0.1}'}
    assert sorted(about["case"]) == [0, 0, 1, 1, 2, 2]
    assert sorted(metrics["jerk"] for metrics in about["metrics"]) == [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]
    first = states[states["rerun_segment_id"] == min(states["rerun_segment_id"])].sort_values("time")
    walked = np.stack([np.stack(agents) for agents in first["/world/agents:Points2D:positions"]])
    np.testing.assert_allclose(walked, driven.position[0, : driven.steps[0] + 1], rtol=1e-6)


def test_decisions_are_kept_of_all_that_is_recorded(driven, tmp_path):
    logs = {"value": np.zeros(driven.gap.shape), "commands": np.ones((*driven.gap.shape, 4, 3))}
    said = dataclasses.replace(driven, logs=logs)
    success, failure = (int(np.flatnonzero((driven.outcome == Outcome.SUCCESS) == wanted)[0]) for wanted in (1, 0))
    with Recorder(tmp_path / "run.rrd", **RUN) as recorder:
        recorder.add(said, np.array([success, failure]), {})
    reader = RrdReader(tmp_path / "run.rrd")
    for entry in reader.recordings():
        paths = {chunk.entity_path for chunk in reader.store(store=entry).stream().to_chunks()}
        assert {"/plots/planner/value", "/world/planner/commands"} <= paths


def test_metrics_are_shown_under_their_titles_with_their_units(tmp_path):
    recorder = Recorder(tmp_path / "a.rrd", planner="", scenario="", scenario_digest="", units={"minimum_gap": "m"})
    measured = {"success_rate": True, "intimate_zone": 0.25, "minimum_gap": 0.5, "mine_rate": 2.0, "spl": np.nan}
    shown = {"success": "yes", "time in intimate zone": "25.0 %", "smallest gap": "0.500 m", "mine": "2.000"}
    assert recorder._texts(measured) == shown
