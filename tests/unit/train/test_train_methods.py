import dataclasses
import inspect
import shlex
from typing import ClassVar

import pytest
from typer.testing import CliRunner

from crowdbench import InputError
from crowdbench.cli import train
from crowdbench.cli.app import app
from crowdbench.networks.encoders import POLICIES
from crowdbench.networks.value import NETWORKS
from crowdbench.train.config import METHODS, ValueConfig, make_config, networks_by_option
from crowdbench.train.runner import Runner


def test_every_network_has_a_method():
    assert set(METHODS) == {*NETWORKS, *POLICIES}


def test_a_network_that_does_not_exist_is_refused():
    with pytest.raises(
        InputError, match="no network is called 'mlp'; there are cadrl, lstm_rl, ppo, ppo_attention, ppo_lidar, sarl"
    ):
        make_config("mlp", {})


@pytest.mark.parametrize(
    ("network", "options", "message"),
    [
        ("cadrl", {"steps": 9}, "--steps is not for cadrl, only for ppo, ppo_attention, ppo_lidar"),
        ("ppo", {"episodes": 9}, "--episodes is not for ppo, only for cadrl, lstm_rl, sarl"),
        ("sarl", {"episodes": 9, "minutes": 1.0}, "--minutes and --episodes both set the length of a training"),
        ("sarl", {"seed": -1}, "--seed is -1, but must be a whole number from 0 to 1000000000"),
        ("ppo", {"steps": 0}, "--steps is 0, but must be a whole number, 1 or more"),
        ("sarl", {"minutes": float("inf")}, "--minutes is inf, but must be a number above 0"),
    ],
)
def test_options_that_contradict_each_other_or_the_network_are_refused(network, options, message):
    with pytest.raises(InputError, match=message):
        make_config(network, options)


@pytest.mark.parametrize(
    ("network", "options"),
    [
        ("cadrl", {"predictor": "linear", "episodes": 9, "scenario": "circle_crossing_5"}),
        ("ppo", {"scenario": "circle_crossing_5", "overrides": {"seed": 1}, "minutes": 1.0}),
    ],
)
def test_options_that_go_together_are_accepted(network, options):
    make_config(network, options)


CONFIGS = [
    ValueConfig(network="lstm_rl"),
    ValueConfig(
        network="cadrl",
        scenario="circle_crossing_5",
        overrides={"vehicle.visible": True, "pedestrians.number": [1, 3], "pedestrians.policy": "orca"},
        predictor="linear",
        seed=3,
        minutes=0.5,
    ),
    ValueConfig(network="sarl", episodes=2_000_000),
    ValueConfig(network="sarl", max_acceleration=6.4, max_turn=2.0, validation="circle_crossing_5,square_crossing_5"),
    ValueConfig(network="cadrl", max_velocity_change=0.8),
    ValueConfig(network="sarl", scenario="eth_reactive", data="eth_ucy"),
]


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Returns a function that returns the options that the command line makes of a command, without training."""
    found = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Runner, "start", lambda config, directory, device: found.append(config))
    monkeypatch.setattr(train, "_run", lambda running: None)

    def ask(command):
        CliRunner().invoke(app, shlex.split(command)[1:], catch_exceptions=False)
        return found

    return ask


@pytest.mark.parametrize("config_", CONFIGS, ids=lambda config: config.command)
def test_the_command_on_a_card_asks_for_the_same_training(config_, asked):
    assert asked(config_.command) == [config_]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Third(ValueConfig):
    """A method with an option of its own and one that it shares.

    Attributes:
        updates: Train for this many updates.
    """

    updates: int = 100

    length: ClassVar[str] = "updates"


def test_a_third_method_is_one_line_of_the_table(monkeypatch):
    monkeypatch.setitem(METHODS, "third", Third)
    assert networks_by_option()["updates"] == ["third"]
    assert networks_by_option()["episodes"] == ["cadrl", "lstm_rl", "sarl", "third"]
    kind = inspect.Parameter.VAR_KEYWORD
    options = train.with_method_options(inspect.Signature([inspect.Parameter("method", kind)])).parameters
    assert options.keys() == networks_by_option().keys()
    [shown] = options["updates"].annotation.__metadata__
    assert (shown.help, shown.show_default) == ("Train for this many updates.", "100")
    assert shown.rich_help_panel == "Options for third only"
    for network, options, message in [
        ("ppo", {"updates": 5}, "--updates is not for ppo, only for third"),
        ("sarl", {"updates": 5}, "--updates is not for sarl, only for third"),
        ("third", {"steps": 5}, "--steps is not for third, only for ppo, ppo_attention, ppo_lidar"),
        ("third", {"updates": 5, "minutes": 1.0}, "--minutes and --updates both set the length of a training"),
        ("mlp", {}, "there are cadrl, lstm_rl, ppo, ppo_attention, ppo_lidar, sarl, third"),
    ]:
        with pytest.raises(InputError, match=message):
            make_config(network, options)
    assert Third(network="third", updates=7).command.endswith("--seed 0 --updates 7")
