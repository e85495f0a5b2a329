"""Trainings that are killed, or cannot write: what is left can be resumed, or begun again."""

import dataclasses
import json
import os
import sys
from typing import ClassVar

import pytest
import torch
import trainings
from typer.testing import CliRunner

from crowdbench import InputError
from crowdbench.cli.app import app
from crowdbench.networks.weights import load_into, read_card
from crowdbench.train import checkpoint, runner
from crowdbench.train.checkpoint import CHECKPOINT, LOCK, hold
from crowdbench.train.config import METHODS, Config
from crowdbench.train.runner import WEIGHTS, Runner
from crowdbench.train.training import Training


class Counting(Training):
    """A training whose network counts to 3."""

    saved = ("network",)

    def __init__(self, config, device):
        super().__init__(config, device)
        self.network = torch.nn.Linear(1, 1)
        torch.nn.init.zeros_(self.network.weight)
        torch.nn.init.zeros_(self.network.bias)

    def describe(self, point):
        return f"{point['rounds']} rounds"

    def best(self):
        return self.curve[-1], self.network

    @property
    def progress(self):
        return len(self.curve) / 3

    def learn(self):
        while len(self.curve) < 3:
            with torch.no_grad():
                self.network.bias += 1
            self.curve.append({"rounds": len(self.curve) + 1})
            yield

    def card(self, progress):
        scenario = {"name": "none", "digest": "", "pedestrians": {"number": [1, 1]}}
        training = {"scenario": scenario, "dt": 0.25, "pooling": False, "windows": 0, "epochs": 3, "seed": 0}
        figures = {"windows": 0, "modes": 1, "ade": 0.0, "fde": 0.0}
        return {
            "training": {**training, "kept_after_epochs": 3, "minutes": 0.0},
            "figures": {"validation": figures},
            "data": "none",
        }


@dataclasses.dataclass(frozen=True, kw_only=True)
class CountConfig(Config):
    """The options of it."""

    rounds: int = 3

    length: ClassVar[str] = "rounds"
    training: ClassVar[str] = f"{__name__}:Counting"
    usage = "run"


CONFIG = CountConfig(network="counting")
FINISHED = {"weights.safetensors", "weights.json", "weights.md", "curve.csv"}


@pytest.fixture(autouse=True)
def method(monkeypatch):
    monkeypatch.setitem(METHODS, "counting", CountConfig)
    monkeypatch.setattr(runner, "_commit", lambda: None)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)  # its thread calls the file system


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


def through(running):
    """Train to the end."""
    list(running.train())
    running.finish(trainings.ignore)


def begun_again(directory):
    """The training in a directory, or a new one where it says that nothing was kept; None where it is finished."""
    try:
        return Runner.resume(directory, "cpu")
    except InputError as error:
        if "is finished: its weights are" in str(error):
            return None
        if "there is no checkpoint" in str(error) or "there is no directory" in str(error):
            return Runner.start(CONFIG, directory, "cpu")
        raise


def killed(kill, directory, calls):
    """Whether a training was killed before its call number `calls`, or else is through."""
    kill.left, kill.directory = calls, str(directory)
    try:
        through(Runner.start(CONFIG, directory, "cpu"))
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
            load_into(Counting(CONFIG, "cpu").network, "counting", directory / WEIGHTS)
        if running := begun_again(directory):
            through(running)
        assert {path.name for path in directory.iterdir()} - {LOCK} == FINISHED
        weights.add(read_card(directory / WEIGHTS)["sha256"])
        calls += 1
    assert calls > 30
    assert len(weights) == 1


def test_an_empty_directory_is_taken(tmp_path):
    list(Runner.start(CONFIG, tmp_path, "cpu").train())
    with pytest.raises(InputError, match=r"holds a training: .* crowdbench train counting --resume"):
        Runner.start(CONFIG, tmp_path, "cpu")


@pytest.mark.parametrize("name", ["mine.txt", ".checkpoint.safetensors.mine"])
def test_a_directory_with_a_users_file_is_refused_and_kept(name, tmp_path):
    (tmp_path / name).touch()
    with pytest.raises(InputError, match="exists already: name another place with --out"):
        Runner.start(CONFIG, tmp_path, "cpu")
    with pytest.raises(InputError, match="there is no checkpoint"):
        Runner.resume(tmp_path, "cpu")
    assert (tmp_path / name).exists()


def test_two_processes_do_not_train_in_the_same_directory(tmp_path):
    running = Runner.start(CONFIG, tmp_path, "cpu")
    with hold(tmp_path, ""), pytest.raises(InputError, match="another process trains in"):
        list(running.train())
    list(running.train())


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
    running = Runner.start(CONFIG, tmp_path / "a", "cpu")
    with pytest.raises(InputError, match="cannot be written: No space left on device; nothing was kept"):
        list(running.train())
    disk.on = False
    assert running.training.curve == []
    list(Runner.start(CONFIG, tmp_path / "a", "cpu").train())


@pytest.mark.parametrize("name", ["curve.csv", "weights.json", "weights.safetensors", "weights.md"])
def test_a_full_disk_leaves_the_last_checkpoint(name, tmp_path):
    running = Runner.start(CONFIG, tmp_path / "a", "cpu")
    disk = full(tmp_path / "a" / name)
    with pytest.raises(InputError, match="No space left on device; its last checkpoint is kept: make room, and go on"):
        through(running)
    disk.on = False
    through(Runner.resume(tmp_path / "a", "cpu"))
    assert {path.name for path in (tmp_path / "a").iterdir()} == FINISHED


def test_a_full_disk_leaves_the_checkpoint_before(tmp_path):
    running = Runner.start(CONFIG, tmp_path / "a", "cpu")
    disk = full(tmp_path / "a" / CHECKPOINT)
    disk.on = False

    training = running.train()
    next(training)
    next(training)
    disk.on = True
    with pytest.raises(InputError, match="its last checkpoint is kept"):
        next(training)
    disk.on = False
    assert Runner.resume(tmp_path / "a", "cpu").training.curve == [{"rounds": 1}, {"rounds": 2}]


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ("{", "cannot be continued: it is damaged"),
        ("[" * 100_000, "cannot be continued: it is damaged, .*RecursionError"),
        (
            '{"config": {"network": "counting"}, "threads": null, "amount": 0, "seconds": 0.0, "curve": []}',
            "cannot be continued: it is damaged",
        ),
        (
            '{"config": {"network": "mlp"}, "threads": 1, "amount": 0, "seconds": 0.0, "curve": []}',
            "cannot be continued: no network is called 'mlp'",
        ),
        (
            '{"config": {"network": "counting", "depth": 1}, "threads": 1, "amount": 0, "seconds": 0.0, "curve": []}',
            "of another version: .*depth",
        ),
        (
            '{"config": {"network": "counting"}, "threads": 0, "amount": 0, "seconds": 0.0, "curve": []}',
            "cannot be continued: .* damaged",
        ),
    ],
)
def test_a_checkpoint_that_makes_no_sense_is_told(metadata, message, tmp_path):
    tensors = {f"network.{name}": tensor for name, tensor in Counting(CONFIG, "cpu").network.state_dict().items()}
    (tmp_path / CHECKPOINT).write_bytes(checkpoint.to_bytes(tensors, metadata={"training": metadata}))
    with pytest.raises(InputError, match=message.replace("another version", "another version of crowdbench")) as error:
        Runner.resume(tmp_path, "cpu")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"network.bias": torch.zeros(1)}, "cannot be continued: .*Missing key"),
        ({"network.bias": torch.full((1,), torch.nan)}, "is damaged, .*network.bias has numbers that are not finite"),
    ],
)
def test_a_checkpoint_with_wrong_tensors_is_told(tensors, message, tmp_path):
    facts = {
        "config": {"network": "counting"},
        "threads": torch.get_num_threads(),
        "amount": 0,
        "seconds": 0.0,
        "curve": [],
    }
    content = checkpoint.to_bytes(tensors, metadata={"training": json.dumps(facts)})
    (tmp_path / CHECKPOINT).write_bytes(content)
    with pytest.raises(InputError, match=message):
        Runner.resume(tmp_path, "cpu")


def test_options_that_resume_would_ignore_are_refused(tmp_path):
    command = ["train", "cadrl", "--resume", str(tmp_path)]
    for more in (
        ["--seed", "0"],
        ["--scenario", "a"],
        ["--set", "a=1"],
        ["--minutes", "1"],
        ["--out", "b"],
        ["--steps", "1"],
        ["--max-turn", "1"],
        ["--validation", "circle_crossing_5"],
    ):
        error = CliRunner().invoke(app, [*command, *more]).exception
        assert isinstance(error, InputError)
        assert str(error).startswith(f"{more[0]} cannot be changed with --resume")
    allowed = CliRunner().invoke(app, [*command, "--device", "cpu"]).exception
    assert "nothing can be resumed there" in str(allowed)


def test_a_training_of_another_network_is_not_resumed(tmp_path):
    next(Runner.start(CONFIG, tmp_path, "cpu").train())
    error = CliRunner().invoke(app, ["train", "cadrl", "--resume", str(tmp_path)]).exception
    assert str(error) == f"the training in {tmp_path} is of counting, not of cadrl"


def test_a_resumed_training_has_its_number_of_threads(tmp_path):
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        next(Runner.start(CONFIG, tmp_path, "cpu").train())
        torch.set_num_threads(2)
        Runner.resume(tmp_path, "cpu", threads=2)
        assert torch.get_num_threads() == 2
        Runner.resume(tmp_path, "cpu")
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(threads)
