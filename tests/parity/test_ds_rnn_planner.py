"""DS-RNN: the answers of its authors' code, and what its planner is shown and does."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import drive
from lookahead_scenes import crowded
from safetensors.torch import save_file

from crowdbench import InputError, load_scenario
from crowdbench.core.dynamics import Unicycle
from crowdbench.plugins.kind import load_module

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "adapters" / "ds_rnn"
RECORDED = json.loads((ROOT / "tests" / "golden" / "ds_rnn.json").read_text())

adapter = load_module(FOLDER / "ds_rnn.py")


def random_network(seed=0):
    torch.manual_seed(seed)
    return adapter.DSRNN().double().eval()


def in_their_layout(network):
    """The state dictionary of the authors' repository, with layers that do not act."""
    theirs = {ours: name for name, ours in adapter.LAYERS.items()}
    state = {"base.critic.0.weight": torch.zeros(2, 2), "dist.logstd._bias": torch.zeros(2, 1)}
    for key, tensor in network.state_dict().items():
        layer, _, part = key.rpartition(".")
        prefix = "" if layer == "action" else "base."
        is_cell = layer in ("node", "temporal", "spatial")
        state[f"{prefix}{theirs[layer]}.{part}{'_l0' if is_cell else ''}"] = tensor.float()
    return state


@pytest.mark.parametrize("name", RECORDED)
def test_the_network_answers_as_its_authors_code_does(name, shared):
    network = adapter.load_ds_rnn(shared / "networks" / f"{name}.safetensors")
    arrays = {key: torch.tensor(values, dtype=torch.float64) for key, values in RECORDED[name].items()}
    node, edges, everybody = torch.zeros(2, 128).double(), torch.zeros(2, 6, 256).double(), torch.ones(2, 5).bool()
    for robot, velocity, away, expected in zip(*arrays.values(), strict=True):
        with torch.inference_mode():
            action, node, edges = network(robot, velocity, away, everybody, node, edges)
        np.testing.assert_allclose(action, expected, atol=1e-5)
    assert torch.stack(list(arrays["action"])).std() > 0.1  # it does not say the same always


@pytest.mark.parametrize("suffix", [".pt", ".safetensors"])
def test_weights_are_read_from_a_checkpoint_and_from_safetensors(suffix, tmp_path):
    network, file = random_network(), tmp_path / f"weights{suffix}"
    (torch.save if suffix == ".pt" else save_file)(in_their_layout(network), file)
    found = adapter.planner(str(file))
    assert all(map(torch.equal, found.network.float().state_dict().values(), network.float().state_dict().values()))
    assert len(found.facts["weights"]) == 12


def test_other_files_get_one_sentence(tmp_path):
    torch.save({"base.robot_linear.weight": torch.zeros(3, 7)}, tmp_path / "other.pt")
    (tmp_path / "text.safetensors").write_text("no weights")
    (tmp_path / "empty.pt").write_text("")
    (tmp_path / "folder.pt").mkdir()
    unreadable = "cannot be read: .*get them from https://github.com"
    for name in ("other.pt", "text.safetensors", "empty.pt", "absent.pt", "folder.pt"):
        sentence = unreadable if name in ("absent.pt", "folder.pt") else "do not belong to a DS-RNN: "
        with pytest.raises(InputError, match=f"{name} {sentence}") as error:
            adapter.load_ds_rnn(tmp_path / name)
        assert "\n" not in str(error.value)


class Shown:
    """A network that keeps what it is shown and asks for the same action always."""

    def __init__(self, action=(3.0, 4.0)):
        self.action, self.calls = torch.tensor(action).double(), []

    def __call__(self, *shown):
        self.calls.append([tensor.numpy() for tensor in shown])
        return self.action.expand(len(shown[0]), 2), *shown[4:]


def test_people_out_of_sight_go_on_at_constant_velocity_and_others_are_not_known_yet():
    network, obs = Shown(), crowded(2, 3)
    planner = adapter.DSRNNPlanner(network)
    planner.reset(obs.row)
    crowd = obs.pedestrians
    seen = np.array([[True, True, False], [True, False, False]])
    later = np.array([[False, False, True], [False, True, False]])
    planner.plan(dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, seen=seen)))
    command = planner.plan(dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, seen=later)))
    own = obs.vehicle.position[:, None]
    first, second = ((away, known) for _, _, away, known, *_ in network.calls)
    assert np.array_equal(first[1], seen)
    assert np.array_equal(second[1], seen | later)
    np.testing.assert_allclose(first[0][seen], (crowd.position - own)[seen], rtol=1e-5)
    gone_on = np.where(seen[..., None], crowd.position + obs.dt * crowd.velocity, crowd.position) - own
    np.testing.assert_allclose(second[0][second[1]], gone_on[second[1]], rtol=1e-5, atol=1e-6)
    robot = np.column_stack(
        [obs.vehicle.position, obs.vehicle.radius, obs.vehicle.goal, obs.vehicle.preferred_speed, np.full(2, np.pi / 2)]
    )
    np.testing.assert_allclose(network.calls[0][0], robot, rtol=1e-5)
    np.testing.assert_allclose(command, obs.vehicle.preferred_speed[:, None] * [[0.6, 0.8]])


def test_people_who_are_not_known_have_no_influence():
    network = random_network()
    robot, velocity, away, *state = (
        torch.randn(2, *shape).double() for shape in ((7,), (2,), (3, 2), (128,), (4, 256))
    )
    known = torch.tensor([[True, True, False], [False, False, False]])
    shown = [network(robot, velocity, each, known, *state) for each in (away, away + 9.0 * ~known[..., None])]
    for one, other in zip(*shown, strict=True):
        assert one.isfinite().all()
        torch.testing.assert_close(one, other)
    fewer = network(robot[:1], velocity[:1], away[:1, :2], known[:1, :2], state[0][:1], state[1][:1, :3])
    torch.testing.assert_close(fewer[0], shown[0][0][:1])


def test_a_unicycle_changes_speed_and_heading_by_a_tenth_at_most():
    obs = crowded(2, 1)
    vehicle = dataclasses.replace(obs.vehicle, dynamics=Unicycle(), velocity=np.array([[0.3, 0.4], [0.0, 0.02]]))
    planner = adapter.DSRNNPlanner(Shown((-3.0, 0.05)), unicycle=True)
    planner.reset(obs.row)
    command = planner.plan(dataclasses.replace(obs, vehicle=vehicle))
    np.testing.assert_allclose(command, [[0.4, 0.05 / obs.dt], [0.0, 0.05 / obs.dt]], atol=1e-9)


def test_each_episode_has_a_memory_of_its_own():
    planner = adapter.DSRNNPlanner(random_network())
    together, alone = drive(planner, "3", time_limit=5.0), drive(planner, "2:3", time_limit=5.0)
    steps = int(alone.steps[0])
    np.testing.assert_allclose(together.command[2, :steps], alone.command[0, :steps], atol=1e-6)
    moving = together.command[2, :steps]
    assert np.ptp(moving, axis=0).max() > 1e-3  # it remembers and looks


@pytest.mark.parametrize("name", ["circle", "circle_unicycle"])
def test_the_scene_has_the_distances_of_its_authors(name):
    scenario = load_scenario(str(FOLDER / f"{name}.toml"))
    world = scenario.draw("val", np.arange(40))
    start, goal = world.position[:, 0], world.goal[:, 0]
    assert (np.linalg.norm(goal - start, axis=1) >= 6.0).all()
    assert (np.abs(goal) <= 6.0).all()
    distance = np.linalg.norm(world.position[:, 1:, None] - np.stack([start, goal], axis=1)[:, None], axis=-1)
    rims = distance - (world.radius[:, 1:] + world.radius[:, :1])[..., None]
    assert rims.min() >= 0.25
    if name == "circle_unicycle":
        np.testing.assert_allclose(np.linalg.norm(start, axis=1), 6.0)
        assert distance.min() >= 3.0
    crossed = np.linalg.norm(world.position[:, 1:] + world.goal[:, 1:], axis=-1)
    np.testing.assert_allclose(crossed, 0.0, atol=1e-9)


def test_a_vehicle_that_needs_too_much_room_gets_one_sentence():
    scenario = load_scenario(str(FOLDER / "circle_unicycle.toml"), {"layout.around_vehicle": 20.0})
    with pytest.raises(InputError, match="no room around the vehicle in 2000 draws"):
        scenario.draw("val", np.arange(1))
