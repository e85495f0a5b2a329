"""Policies in CrowdNav's manner drive as planners. All of them are written here: CrowdNav need not be installed."""

import dataclasses
import math
import re
import shutil
import sys
from collections import namedtuple
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import torch
from crowdnav_policies import (
    MINE,
    Abstract,
    ActionRot,
    ActionXY,
    NativePushed,
    NativeStraight,
    Policy,
    Pushed,
    Restless,
    Says,
    Straight,
    Uncopied,
)
from helpers import drive, same, world
from typer.testing import CliRunner

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli.app import app
from crowdbench.networks.weights import weights_digest
from crowdbench.plugins.kind import load_module
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError

FILE = Path(__file__).parents[2] / "adapters" / "crowdnav" / "crowdnav.py"

crowdnav = load_module(FILE)
CrowdNavPlanner = crowdnav.CrowdNavPlanner


def scene(heading=0.0, **changes):
    """What a vehicle sees of two pedestrians; changes are of the pedestrians."""
    made = world(
        [[0.5, -4.0], [1.0, 2.0], [-3.0, 1.5]], [[0.1, 0.2], [0.3, -0.4], [0.5, 0.6]], [[0.0, 4.0], [9, 9], [8, 8]]
    )
    radius, speed = np.array([[0.3, 0.4, 0.5]]), np.array([[1.2, 7.0, 8.0]])
    obs = observe(made.replace(heading=np.array([heading]), radius=radius, preferred_speed=speed))
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(obs.pedestrians, **changes))


def started(policy, rows=1):
    planner = CrowdNavPlanner(policy)
    planner.reset(np.arange(rows))
    return planner


def shown(obs):
    """The state that a policy is shown."""
    states = []
    started(Says(lambda state: states.append(state) or ActionXY(0.0, 0.0))).plan(obs)
    (state,) = states
    return state


def test_a_state_has_crowdnavs_numbers_in_its_order():
    state = shown(scene(heading=-math.pi / 2))
    own = (0.5, -4.0, 0.1, 0.2, 0.3, 0.0, 4.0, 1.2, 1.5 * math.pi)
    humans = [(1.0, 2.0, 0.3, -0.4, 0.4), (-3.0, 1.5, 0.5, 0.6, 0.5)]
    assert [state.self_state + human for human in state.human_states] == [own + human for human in humans]
    named = state.self_state
    assert (named.px, named.py, named.vx, named.vy, named.radius, named.gx, named.gy, named.v_pref, named.theta) == own
    assert (named.position, named.velocity, named.goal_position) == ((0.5, -4.0), (0.1, 0.2), (0.0, 4.0))
    named = state.human_states[1]
    assert (named.px, named.py, named.vx, named.vy, named.radius) == humans[1]
    assert (named.position, named.velocity) == ((-3.0, 1.5), (0.5, 0.6))
    state.human_states = sorted(state.human_states)  # as CrowdNav's LSTM-RL does
    assert {type(number) for number in state.self_state + state.human_states[0]} == {float}


def test_the_same_policy_drives_as_a_native_planner_does():
    assert same(drive(CrowdNavPlanner(Straight()), "6"), drive(NativeStraight(), "6"))


def test_pedestrians_are_shown_as_to_a_native_planner():
    start = load_scenario("circle_crossing_mixed").draw("val", np.arange(12))
    assert not start.present.all()  # some worlds have padding
    moving = np.random.default_rng(0).uniform(-0.5, 0.5, start.velocity.shape)
    obs = observe(start.replace(velocity=moving))
    commands = started(Pushed(), 12).plan(obs)
    assert np.abs(commands).min() > 1e-4
    np.testing.assert_allclose(commands, NativePushed().plan(obs), rtol=1e-12)


@pytest.mark.parametrize("seen", [[True, False], [False, True]])
def test_pedestrians_that_are_not_seen_are_not_shown(seen):
    hidden = np.where(np.array([seen])[..., None], scene().pedestrians.position, np.nan)
    state = shown(scene(seen=np.array([seen]), position=hidden))
    expected = [human for human, is_seen in zip([(1.0, 2.0), (-3.0, 1.5)], seen, strict=True) if is_seen]
    assert [human.position for human in state.human_states] == expected


def test_a_turn_on_the_spot_and_one_in_reverse_are_remembered_until_the_next_episode():
    actions = [ActionRot(0.0, 1.0), ActionRot(-0.5, 1.0), ActionRot(0.5, 5.0)]
    thetas = []

    def answer(state):
        thetas.append(state.self_state.theta)
        return actions[len(thetas) - 1]

    planner = started(Says(answer))
    commands = [planner.plan(scene(heading=0.25))[0] for _ in actions]
    np.testing.assert_allclose(thetas, [0.25, 1.25, 2.25])
    directions = [[math.cos(angle), math.sin(angle)] for angle in (1.25, 2.25, 7.25)]
    np.testing.assert_allclose(commands, np.array([[0.0], [-0.5], [0.5]]) * directions)
    actions.append(ActionRot(0.0, 0.0))
    planner.plan(scene(heading=0.25))
    assert thetas[-1] == pytest.approx(7.25 - 2 * math.pi)  # in [0, 2 pi), as in CrowdNav
    actions.append(ActionRot(0.0, 0.0))
    planner.reset(np.arange(1))
    planner.plan(scene(heading=0.25))
    assert thetas[-1] == 0.25


def test_every_episode_has_a_policy_of_its_own():
    policy = Restless()
    planner = CrowdNavPlanner(policy)
    together = drive(planner, "3")
    assert same(together, drive(planner, "3"))
    alone = drive(CrowdNavPlanner(policy), "test:2:3")
    steps = alone.steps[0]
    assert np.array_equal(alone.command[0, :steps], together.command[2, :steps])
    assert (policy.states, policy.phase) == ([], None)  # the object that was given is as it was


def test_a_policy_is_prepared_as_in_crowdnavs_test():
    class Keeps(Policy):
        found: ClassVar[list] = []  # of the class, so that copies share it

        def predict(self, state):
            self.found.append((self.phase, self.device, self.time_step))
            return ActionXY(0.0, 0.0)

    policy = Keeps()
    started(policy).plan(dataclasses.replace(scene(), dt=0.1))
    policy.device = "cuda:1"
    started(policy).plan(scene())
    assert Keeps.found == [("test", "cpu", 0.1), ("test", "cuda:1", 0.25)]


def test_a_simulator_that_a_policy_keeps_is_made_anew_in_every_episode():
    class Orca(Policy):
        made: ClassVar[list] = []

        def __init__(self):
            super().__init__()
            self.sim = Uncopied()

        def predict(self, state):
            if self.sim is None:
                self.sim = Uncopied()
                self.made.append(len(state.human_states))
            return ActionXY(0.0, 0.0)

    policy = Orca()
    before = policy.sim
    planner = started(policy)
    planner.plan(scene())
    planner.plan(scene())
    planner.reset(np.arange(1))
    planner.plan(scene())
    assert Orca.made == [2, 2]
    assert policy.sim is before


def test_worlds_share_the_weights_and_results_have_their_digest():
    class Network(Policy):
        used: ClassVar[list] = []

        def __init__(self):
            super().__init__()
            self.model = torch.nn.Linear(2, 2, bias=False)
            torch.nn.init.constant_(self.model.weight, 0.25)
            self.count = [0]

        def predict(self, state):
            self.used.append((self.model.weight, self.count))
            return ActionXY(*self.model(torch.ones(2)).tolist())

    policy = Network()
    planner = CrowdNavPlanner(policy)
    assert planner.facts == {"policy": "Network", "weights": weights_digest(policy.model)}
    torch.nn.init.zeros_(policy.model.weight)  # whoever trains on does not change the planner
    trace = drive(planner, "2", time_limit=2.0)
    assert (trace.command[:, 0] == 0.5).all()
    weights, counts = zip(*Network.used[:2], strict=True)
    assert weights[0] is weights[1]
    assert counts[0] is not counts[1]


def test_states_are_of_the_classes_that_the_policys_code_knows(monkeypatch):
    full, human = namedtuple("FullState", crowdnav.FullState._fields), crowdnav.ObservableState
    home = ModuleType("my_states")
    home.FullState, home.ObservableState, home.JointState = (
        full,
        human,
        lambda own, humans: SimpleNamespace(self_state=own, human_states=humans),
    )
    full.__module__ = "my_states"
    user = ModuleType("my_policies")
    user.FullState = full

    class Own(Says):
        __module__ = "my_policies"

    def kind_of(policy_class):
        kinds = []
        answer = lambda state: kinds.append((type(state), type(state.self_state))) or ActionXY(0.0, 0.0)  # noqa: E731
        started(policy_class(answer)).plan(scene())
        return kinds[0]

    assert kind_of(Own) == kind_of(Says) == (crowdnav.JointState, crowdnav.FullState)
    monkeypatch.setitem(sys.modules, "my_states", home)
    monkeypatch.setitem(sys.modules, "my_policies", user)
    assert kind_of(Own) == (SimpleNamespace, full)
    assert kind_of(Says) == (crowdnav.JointState, crowdnav.FullState)
    monkeypatch.setitem(sys.modules, "crowd_sim.envs.utils.state", home)
    assert kind_of(Says) == (SimpleNamespace, full)


def with_(policy, **attributes):
    for name, value in attributes.items():
        setattr(policy, name, value)
    return policy


REFUSED = {
    "no predict": (Policy(), "a policy of CrowdNav has a method predict(state), but this Policy has none of its own"),
    "an abstract one": (Abstract(), "has a method predict(state), but this Abstract has none of its own"),
    "a class": (Straight, "takes a policy object, but Straight is a class"),
    "the future": (with_(Straight(), query_env=True), "the policy Straight has query_env = True: it would read"),
    "not copied": (with_(Straight(), handle=Uncopied()), "the policy Straight cannot be copied or prepared, which"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_policy_that_cannot_drive_is_refused_in_one_sentence(name):
    policy, sentence = REFUSED[name]
    with pytest.raises(InputError) as error:
        CrowdNavPlanner(policy)
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


ANSWERS = {
    "nothing": (None, "the policy Says returned a NoneType, but must return ActionXY(vx, vy) or ActionRot(v, r)"),
    "a text": (ActionXY("north", 0.0), "returned ActionXY(vx='north', vy=0.0), in which something is no number"),
    "NaN": (ActionXY(math.nan, 0.0), "returned [nan, 0.0], but a command must be finite (case 1, step 0)"),
    "too fast": (ActionRot(1.5, 0.5), "asked for 1.5 m/s, but the vehicle's maximum is 1 m/s (case 1, step 0)"),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_that_is_no_action_is_refused_in_one_sentence(name):
    action, sentence = ANSWERS[name]
    with pytest.raises(InputError) as error:
        drive(CrowdNavPlanner(Says(lambda state: action)), "test:1:3")
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


def test_a_policy_that_asks_its_environment_is_refused():
    class Cadrl(Policy):
        def predict(self, state):
            return self.env.onestep_lookahead(ActionXY(0.0, 0.0))

    policy = with_(Cadrl(), env=SimpleNamespace(onestep_lookahead=lambda action: action), query_env=False)
    with pytest.raises(InputError, match=r"the policy reads .* from env\.onestep_lookahead, which no vehicle can see"):
        drive(CrowdNavPlanner(policy), "2")


def test_a_planner_of_one_line_keeps_the_contract(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    shutil.copy(FILE, tmp_path)
    done = CliRunner().invoke(app, ["check", str(tmp_path / "mine.py"), "--cases", "val:3"])
    assert done.exit_code == 0, done.output
    assert re.search(r"independent +\d\d+ commands are the same", done.output)


def test_a_policy_is_always_shown_somebody_where_there_is_anybody():
    class Keeps(Policy):
        shown: ClassVar = []

        def predict(self, state):
            self.shown.append((state.self_state.position, state.human_states))
            return ActionXY(0.0, 1.0)

    drive(CrowdNavPlanner(Keeps()), "1", sensor__range=1.0)
    alone = [(own, humans[0]) for own, humans in Keeps.shown if humans[0].velocity == (0.0, 0.0) and len(humans) == 1]
    assert all(humans for _, humans in Keeps.shown)
    assert alone[0][1].position == pytest.approx((alone[0][0][0], alone[0][0][1] - 20.0))


class Sarl(Straight):
    query_env = True

    def configure(self, config):
        self.model = torch.nn.Linear(int(config.get("sarl", "inputs")), 1)

    def get_model(self):
        return self.model


class NoNetwork(Straight):
    def configure(self, config):
        self.model = None


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """The folder of a trained model in a clone of CrowdNav."""
    factory = ModuleType("crowd_nav.policy.policy_factory")
    factory.policy_factory = {"sarl": Sarl, "orca": NoNetwork}
    for name in ("crowd_nav", "crowd_nav.policy", "crowd_nav.policy.policy_factory"):
        monkeypatch.setitem(sys.modules, name, factory)
    for name in ("rvo2", "gym", "gym.envs.registration"):  # which the example replaces
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    trained = tmp_path / "CrowdNav" / "crowd_nav" / "data" / "output"
    trained.mkdir(parents=True)
    (trained / "policy.config").write_text("[sarl]\ninputs = 3\n")
    network = torch.nn.Linear(3, 1)
    torch.save(network.state_dict(), trained / "rl_model.pth")
    return trained


def test_a_network_of_a_clone_drives(trained):
    network = torch.nn.Linear(3, 1)
    network.load_state_dict(torch.load(trained / "rl_model.pth"))
    planner = load_planner(str(FILE))
    assert planner.facts == {"policy": "Sarl", "weights": weights_digest(network)}
    assert same(drive(planner, "2"), drive(NativeStraight(), "2"))


def replace_by_folder(file):
    file.unlink()
    file.mkdir()


WRONG = {
    "no config": (
        lambda at: (at / "policy.config").unlink(),
        "there is no model in .*output, .* no file policy.config",
    ),
    "no weights": (
        lambda at: (at / "rl_model.pth").unlink(),
        "no file rl_model.pth: train first, with python train",
    ),
    "neither": (shutil.rmtree, "no file policy.config and no rl_model.pth: train first"),
    "folders": (lambda at: replace_by_folder(at / "rl_model.pth"), "no file rl_model.pth: train first"),
    "no clone": (
        lambda at: shutil.rmtree(at.parents[2]),
        "there is no clone of CrowdNav in CrowdNav: git clone",
    ),
    "empty config": (lambda at: (at / "policy.config").write_text(""), "policy.config configures no sarl: No section"),
    "wrong config": (
        lambda at: (at / "policy.config").write_text("sarl"),
        "policy.config configures no sarl: File",
    ),
    "no number": (
        lambda at: (at / "policy.config").write_text("[sarl]\ninputs = a"),
        "configures no sarl: invalid",
    ),
    "binary config": (lambda at: (at / "policy.config").write_bytes(b"\xff\x00"), "configures no sarl: 'utf-8' codec"),
    "empty weights": (
        lambda at: (at / "rl_model.pth").write_text(""),
        "rl_model.pth cannot be read, or holds something other",
    ),
    "text": (lambda at: (at / "rl_model.pth").write_text("a"), "rl_model.pth cannot be read, or holds something other"),
    "other weights": (
        lambda at: torch.save({"weight": torch.zeros(2)}, at / "rl_model.pth"),
        "rl_model.pth has no weights of sarl as policy.config configures it: Error.* in loading state_dict",
    ),
    "code": (
        lambda at: torch.save(torch.nn.Linear(3, 1), at / "rl_model.pth"),
        "rl_model.pth cannot be read, or holds something other than tensors",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_missing_or_broken_model_gets_one_sentence(name, trained):
    change, sentence = WRONG[name]
    change(trained)
    with pytest.raises(InputError, match=sentence) as error:
        load_planner(str(FILE))
    assert "\n" not in str(error.value)


def test_a_policy_without_a_network_and_an_unknown_one_get_one_sentence(trained):
    with pytest.raises(InputError, match="CrowdNav has no policy 'sal', but sarl, orca"):
        load_planner(str(FILE), {"policy": "sal"})
    with pytest.raises(InputError, match="the policy orca of CrowdNav has no network: give --option policy=sarl"):
        load_planner(str(FILE), {"policy": "orca"})


def test_a_folder_that_is_no_clone_gets_one_sentence(trained, monkeypatch):
    monkeypatch.setitem(sys.modules, "crowd_nav.policy.policy_factory", None)
    with pytest.raises(InputError, match="CrowdNav is no clone of CrowdNav: "):
        load_planner(str(FILE))
