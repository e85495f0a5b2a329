"""Trainings that are killed, or cannot write: what is left can be resumed, or begun again."""

import dataclasses
import os
import sys
from typing import ClassVar

import pytest
import torch
from typer.testing import CliRunner

from crowdbench import InputError
from crowdbench.cli import app
from crowdbench.networks.weights import load_into, read_card
from crowdbench.train import checkpoint, training_run
from crowdbench.train.checkpoint import CHECKPOINT, LOCK, WEIGHTS, State, hold
from crowdbench.train.method import CardText, Request
from crowdbench.train.methods import METHODS
from crowdbench.train.training_run import TrainingRun


@dataclasses.dataclass(frozen=True)
class Point:
    """A point of the curve."""

    rounds: int


class Counting:
    """A training whose network counts to 3."""

    validated_on = 1

    def __init__(self):
        self.best = torch.nn.Linear(1, 1)
        torch.nn.init.zeros_(self.best.weight)
        torch.nn.init.zeros_(self.best.bias)
        self.curve = []

    def best_point(self):
        return self.curve[-1]

    @property
    def progress(self):
        return len(self.curve) / 3

    def run(self, after_validation):
        while len(self.curve) < 3:
            with torch.no_grad():
                self.best.bias += 1
            self.curve.append(Point(len(self.curve) + 1))
            after_validation()

    def state(self):
        return State(checkpoint.tensors_of("best", self.best), {}, self.curve)

    def restore(self, state):
        self.best.load_state_dict(checkpoint.part_of("best", state.tensors))
        self.curve = [Point(**point) for point in state.curve]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CountRequest(Request):
    """The request for it."""

    length: ClassVar[str] = "seed"
    arguments = ()
    use = "run"
    card_cases = 0

    @classmethod
    def check(cls, options):
        pass

    def training(self, device):
        return Counting()

    def make_card(self, training, progress):
        return {"training": {"seed": 0, "minutes": 0.0}, "figures": {}, "data": "none"}

    @classmethod
    def card_text(cls, card):
        return CardText("", {}, [])


REQUEST = CountRequest(network="counting")
FINISHED = {"weights.safetensors", "weights.json", "weights.md", "curve.csv", "training.rrd"}


@pytest.fixture(autouse=True)
def method(monkeypatch):
    monkeypatch.setitem(METHODS, "counting", CountRequest)
    monkeypatch.setattr(training_run, "_commit", lambda: None)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)  # whose files are not in the way of anything


class Killed(BaseException):
    """Stands for SIGKILL: from then on, no call reaches the file system."""


class Kill:
    """Kills before the call number `at` that changes a directory; an audit hook, since there is none to forget."""

    CALLS: ClassVar = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate"}

    def __init__(self):
        self.directory, self.left = None, 0
        sys.addaudithook(self)

    def __call__(self, event, arguments):
        if self.directory is None or not (event in self.CALLS or event == "open"):
            return
        writes = event != "open" or (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if writes and str(arguments[0]).startswith(self.directory):
            self.left -= 1
            if self.left < 0:
                raise Killed


@pytest.fixture(scope="module")
def kill():
    return Kill()


def ignore(*arguments):
    """A listener that does nothing."""


def through(running):
    """Train to the end."""
    running.train(ignore)
    running.finish(ignore)


def begun_again(directory):
    """The training in a directory, or a new one where it says that nothing was kept; None where it is finished."""
    try:
        return TrainingRun.resumed(directory, "cpu")
    except InputError as error:
        if "is finished: its weights are" in str(error):
            return None
        if "there is no directory" in str(error) or "was stopped before its first checkpoint" in str(error):
            return TrainingRun.new(REQUEST, directory, "cpu")
        raise


def killed(kill, directory, calls):
    """Whether a training was killed before its call number `calls`, or else is through."""
    kill.left, kill.directory = calls, str(directory)
    try:
        through(TrainingRun.new(REQUEST, directory, "cpu"))
    except Killed:
        return True
    finally:
        kill.directory = None
    return False


def test_a_kill_before_any_call_of_the_file_system_leaves_a_training_that_goes_on(kill, tmp_path):
    calls, weights = 0, set()
    while killed(kill, tmp_path / str(calls), calls):
        directory = tmp_path / str(calls)
        if (directory / WEIGHTS).exists():
            load_into(Counting().best, "counting", directory / WEIGHTS)
        if running := begun_again(directory):
            through(running)
        assert {path.name for path in directory.iterdir()} - {LOCK} == FINISHED
        weights.add(read_card(directory / WEIGHTS)["sha256"])
        calls += 1
    assert calls > 30
    assert len(weights) == 1


def test_an_empty_directory_is_taken(tmp_path):
    TrainingRun.new(REQUEST, tmp_path, "cpu").train(ignore)
    with pytest.raises(InputError, match=r"holds a training already: .* crowdbench train counting --resume"):
        TrainingRun.new(REQUEST, tmp_path, "cpu")


@pytest.mark.parametrize("name", ["mine.txt", ".checkpoint.safetensors.mine"])
def test_a_directory_with_a_users_file_is_refused_and_kept(name, tmp_path):
    (tmp_path / name).touch()
    with pytest.raises(InputError, match="exists already: name another place with --out"):
        TrainingRun.new(REQUEST, tmp_path, "cpu")
    with pytest.raises(InputError, match="there is no checkpoint"):
        TrainingRun.resumed(tmp_path, "cpu")
    assert (tmp_path / name).exists()


def test_two_processes_do_not_train_in_the_same_directory(tmp_path):
    running = TrainingRun.new(REQUEST, tmp_path, "cpu")
    with hold(tmp_path), pytest.raises(InputError, match="another process trains in"):
        running.train(ignore)
    running.train(ignore)


def full(path):
    """A disk that is full from the file `path` on."""

    def hook(event, arguments):
        if hook.on and event == "os.rename" and str(arguments[1]) == str(path):
            raise OSError(28, "No space left on device")

    hook.on = True
    sys.addaudithook(hook)
    return hook


def test_a_place_where_nothing_can_be_written_is_told_at_once(tmp_path):
    disk = full(tmp_path / "a" / CHECKPOINT)
    running = TrainingRun.new(REQUEST, tmp_path / "a", "cpu")
    with pytest.raises(InputError, match="cannot be written: No space left on device; nothing was kept"):
        running.train(ignore)
    disk.on = False
    assert running.training.curve == []
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["curve.csv", "weights.json", "weights.safetensors", "weights.md", "training.rrd"])
def test_a_full_disk_leaves_the_last_checkpoint(name, tmp_path):
    running = TrainingRun.new(REQUEST, tmp_path / "a", "cpu")
    disk = full(tmp_path / "a" / name)
    with pytest.raises(InputError, match="No space left on device; its last checkpoint is kept: make room, and go on"):
        through(running)
    disk.on = False
    through(TrainingRun.resumed(tmp_path / "a", "cpu"))
    assert {path.name for path in (tmp_path / "a").iterdir()} == FINISHED


def test_a_full_disk_leaves_the_checkpoint_before(tmp_path):
    running = TrainingRun.new(REQUEST, tmp_path / "a", "cpu")
    disk = full(tmp_path / "a" / CHECKPOINT)
    disk.on = False

    def fill(point, done):
        disk.on = point.rounds == 2

    with pytest.raises(InputError, match="its last checkpoint is kept"):
        running.train(fill)
    disk.on = False
    assert TrainingRun.resumed(tmp_path / "a", "cpu").training.curve == [Point(1), Point(2)]


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ("{", "is not a checkpoint of a training"),
        ("[" * 100_000, "is not a checkpoint of a training: RecursionError"),
        ("9" * 5000, "is not a checkpoint of a training: ValueError"),
        ("[]", "is not a checkpoint of a training: it must have about, facts, curve"),
        ('{"about": {}, "facts": {}, "curve": 3}', "it must have about, facts, curve"),
        ('{"about": {}, "facts": {}, "curve": []}', "cannot be continued: .*network"),
        ('{"about": {"network": "mlp"}, "facts": {}, "curve": []}', "cannot be continued: no network is called 'mlp'"),
        ('{"about": {"network": ["a"]}, "facts": {}, "curve": []}', "cannot be continued: "),
        ('{"about": {"network": "counting", "depth": 1}, "facts": {}, "curve": []}', "of another version: .*depth"),
        ('{"about": {"network": "counting"}, "facts": {}, "curve": [3]}', "cannot be continued: .* damaged"),
    ],
)
def test_a_checkpoint_that_makes_no_sense_is_told(metadata, message, tmp_path):
    tensors = checkpoint.tensors_of("best", Counting().best)
    (tmp_path / CHECKPOINT).write_bytes(checkpoint.to_bytes(tensors, metadata={"training": metadata}))
    with pytest.raises(InputError, match=message.replace("another version", "another version of crowdbench")) as error:
        TrainingRun.resumed(tmp_path, "cpu")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"best.bias": torch.zeros(1)}, "cannot be continued: .*Missing key"),
        ({"best.bias": torch.full((1,), torch.nan)}, "is damaged: best.bias has numbers that are not finite"),
    ],
)
def test_a_checkpoint_with_wrong_tensors_is_told(tensors, message, tmp_path):
    checkpoint.save(State(tensors, {}, []), tmp_path / CHECKPOINT, {"network": "counting"})
    with pytest.raises(InputError, match=message):
        TrainingRun.resumed(tmp_path, "cpu")


def test_options_that_resume_would_ignore_are_refused(tmp_path):
    command = ["train", "cadrl", "--resume", str(tmp_path)]
    for more in (
        ["--seed", "0"],
        ["--scenario", "a"],
        ["--set", "a=1"],
        ["--minutes", "1"],
        ["--out", "b"],
        ["--dt", "1"],
        ["--max-turn", "1"],
        ["--validation", "circle_crossing_5"],
    ):
        error = CliRunner().invoke(app, [*command, *more]).exception
        assert isinstance(error, InputError)
        assert str(error).startswith(f"{more[0]} cannot be changed with --resume")
    allowed = CliRunner().invoke(app, [*command, "--device", "cpu"]).exception
    assert "was stopped before its first checkpoint" in str(allowed)


def test_a_training_of_another_network_is_not_resumed(tmp_path):
    with pytest.raises(InterruptedError):
        TrainingRun.new(REQUEST, tmp_path, "cpu").train(interrupt)
    error = CliRunner().invoke(app, ["train", "cadrl", "--resume", str(tmp_path)]).exception
    assert str(error) == f"the training in {tmp_path} is of counting, not of cadrl"


def interrupt(*point):
    """A listener that stops the training."""
    raise InterruptedError
