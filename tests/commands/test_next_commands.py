"""Commands that are printed for the user to run next: they run as printed, also where paths contain spaces."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import recordings

from crowdbench.record import viewer
from crowdbench.results.run_result import RunResult
from crowdbench.train import checkpoint
from crowdbench.utils.commands import command
from crowdbench.utils.errors import InputError

STROLL = """
from crowdbench import PedestrianPolicy


class Stroll(PedestrianPolicy):
    def velocities(self, world, parameters):
        return -0.5 * world.position[:, 1:]  # to the middle, through which the vehicle drives


def policy():
    return Stroll()
"""

LAYOUT = """
import numpy as np
from crowdbench.scenario import Placement


def layout(rng, radius, preferred_speed):
    start = np.array([[0.0, -4.0], *([float(k), 4.0] for k in range(len(radius) - 1))])
    return Placement(start, -start)
"""

RESPAWN = """

from crowdbench.scenario import LayoutWithRespawn


def again(rng, surroundings, radius, preferred_speed, position):
    return None


layout = LayoutWithRespawn(layout, again)
"""


def printed(text, *words):
    """The words of the commands in a text that begin with these words, each to the end of its line."""
    found = re.findall(rf"{' '.join(words)} [^`\n]*", text)
    return [shlex.split(one) for one in found]


@pytest.fixture
def shown(monkeypatch):
    """The cases that the viewer is asked to show."""
    cases = []
    monkeypatch.setattr(viewer, "view", lambda path, case, *, web: cases.append(case))
    return cases


def test_words_are_quoted():
    assert command("view", Path("a b"), "--case", 3) == "crowdbench view 'a b' --case 3"


@pytest.mark.slow
def test_the_command_that_shows_a_failure_has_the_data_of_the_run(tmp_path, call, shown):
    folder = tmp_path / "my tracks"
    folder.mkdir()
    file = recordings.write(folder)
    words = ["run", "--planner", "straight", "--scenario", str(file), "--data", str(folder), "--cases", "6"]
    said = call(*words, "--out", str(tmp_path / "a run")).stdout
    views = printed(said, ": crowdbench", "view")
    assert views
    for words in views:
        assert words[-2:] == ["--data", str(folder)]
        assert call(*words[2:]).returncode == 0
    failures = RunResult.read(tmp_path / "a run").episodes.failures.values()
    assert shown == [cases[0] for cases in failures]


def test_the_command_that_shows_a_failure_has_the_users_policy(tmp_path, call, shown):
    file = tmp_path / "my policies" / "stroll.py"
    file.parent.mkdir()
    file.write_text(STROLL)
    words = ["run", "--planner", "straight", "--pedestrians", str(file), "--cases", "val:12", "--record", "commands"]
    said = call(*words, "--out", str(tmp_path / "a run")).stdout
    views = printed(said, ": crowdbench", "view")
    assert views
    for words in views:
        assert words[-2:] == ["--pedestrians", str(file)]
        assert call(*words[2:]).returncode == 0
        assert shown


@pytest.mark.parametrize("respawn", ["", RESPAWN], ids=["plain", "respawn"])
def test_the_command_that_shows_a_failure_has_the_users_layout(tmp_path, call, shown, respawn):
    file = tmp_path / "my layouts" / "narrow.py"
    file.parent.mkdir()
    file.write_text(LAYOUT + respawn)
    scenario = tmp_path / "narrow.toml"
    scenario.write_text('[layout]\ngenerator = "./my layouts/narrow.py"\n[pedestrians]\nnumber = 3\n')
    words = ["run", "--planner", "straight", "--scenario", str(scenario), "--record", "commands"]
    said = call(*words, "--cases", "val:6", "--out", str(tmp_path / "a run")).stdout
    (words,) = printed(said, ": crowdbench", "view")
    assert words[-2:] == ["--layout", str(file)]
    assert call(*words[2:]).returncode == 0
    assert shown


def test_the_command_after_a_metric_that_failed_has_the_options_of_the_run(tmp_path, call):
    metric, folder = tmp_path / "a metric.py", tmp_path / "my tracks"
    metric.write_text(
        "import numpy as np\n\n\ndef metric(trace):\n    if (trace.case > 3).any():\n        raise ValueError\n"
        "    return np.ones(len(trace))\n"
    )
    folder.mkdir()
    file = recordings.write(folder)
    words = ["run", "--planner", "straight", "--scenario", str(file), "--data", str(folder), "--cases", "6"]
    done = call(*words, "--out", str(tmp_path / "a run"), "--metric", str(metric), "--batch", "2")
    assert done.returncode == 1
    (words,) = printed(done.stderr, "crowdbench", "score")
    metric.write_text("import numpy as np\n\n\ndef metric(trace):\n    return np.ones(len(trace))\n")
    assert call(*words[1:]).returncode == 0


def test_the_commands_after_a_new_planner_name_its_file(tmp_path, call):
    said = call("new-planner", "strolling", "--out", str(tmp_path / "my planners")).stderr
    found = printed(said, "crowdbench")
    assert [words[1] for words in found] == ["check", "run", "suite"]
    assert {word for words in found for word in words if word.endswith(".py")} == {
        str(tmp_path / "my planners" / "strolling" / "strolling.py")
    }
    assert call(*found[1][1:], "--cases", "1", "--out", str(tmp_path / "run")).returncode == 0


def test_the_command_that_goes_on_with_a_training_quotes_its_directory(tmp_path):
    folder = tmp_path / "a training"
    folder.mkdir()
    (folder / checkpoint.CHECKPOINT).write_text("")
    with pytest.raises(InputError) as error:
        checkpoint.check_free(folder, "crowdbench train sarl")
    assert shlex.split(str(error.value))[-4:] == ["train", "sarl", "--resume", str(folder)]


@pytest.mark.parametrize("format", ["txt", "socnav", "rosbag2", "replay"])
def test_an_export_says_where_its_files_are(format, tmp_path, call):
    if format == "rosbag2":
        pytest.importorskip("rosbags")
    call("run", "--planner", "straight", "--cases", "val:2", "--out", str(tmp_path / "run"))
    said = call("export", str(tmp_path / "run"), "--out", str(tmp_path / "a b"), "--format", format).stdout
    folder = tmp_path / "a b"
    if format == "replay":
        assert said.splitlines()[-1] == f"2 cases in {folder / 'index.html'}"
        assert (folder / "index.html").is_file()
    else:
        first = {"txt": "val-0.txt", "socnav": "val-0.json", "rosbag2": "val-0"}[format]
        steps = f"their steps are in {folder / 'steps.parquet'}"
        assert said.splitlines()[-1] == f"2 cases in {folder / 'tracks'}, such as {first}; {steps}"
        assert (folder / "tracks" / first).exists()
        assert (folder / "steps.parquet").is_file()
        assert np.array_equal(RunResult.read(tmp_path / "run").episodes.case, [0, 1])
