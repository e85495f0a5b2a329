"""Networks of CrowdNav++: what they are shown, and that each episode has its own memory."""

import dataclasses
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lookahead_scenes import DT, crowded

from crowdbench import load_scenario
from crowdbench.planners.driver import Driver
from crowdbench.plugins.kind import load_module
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

adapter = load_module(Path(__file__).parents[2] / "adapters" / "crowdnav_plus" / "crowdnav_plus.py")
AWAY, STEPS, UNKNOWN = adapter.AWAY, adapter.STEPS, adapter.UNKNOWN
CrowdNavPlusPlanner = adapter.CrowdNavPlusPlanner


class Network(torch.nn.Module):
    """As CrowdNav++'s `Policy` is asked; it turns a little more to the left with every step of an episode."""

    def __init__(self, numbers=12):
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))
        self.base = SimpleNamespace(
            human_num=6,
            human_node_rnn_size=3,
            human_human_edge_rnn_size=2,
            spatial_attn=SimpleNamespace(input_size=numbers),
        )

    def act(self, inputs, memory, masks, deterministic):
        assert deterministic
        assert self.base.nenv == len(masks)
        self.inputs = inputs
        count = memory["human_node_rnn"] * masks[:, :, None] + 1.0
        action = torch.stack([torch.ones(len(masks)), 0.1 * count[:, 0, 0]], dim=1)
        return None, action, None, {**memory, "human_node_rnn": count}


class Still:
    """A predictor that keeps its inputs, and knows nobody but the first one, who will be in the origin."""

    def forward(self, past, seen):
        self.past, self.seen = past.clone(), seen.clone()
        known = torch.zeros(*past.shape[:2], 1)
        known[:, 0] = 1.0
        return torch.zeros(*past.shape[:2], STEPS, 5), known


def shown(planner, obs):
    planner.reset(obs.row)
    planner.plan(obs)
    return planner.network.inputs


def test_people_in_sight_are_shown_nearest_first_with_five_steps_and_the_others_far_away():
    obs = crowded()
    age = np.where(obs.pedestrians.seen, 0.0, np.inf)
    age[1, 2] = 0.5  # remembered
    obs = dataclasses.replace(obs, pedestrians=dataclasses.replace(obs.pedestrians, age=age))
    inputs, crowd = shown(CrowdNavPlusPlanner(Network()), obs), obs.pedestrians
    edges, ahead = inputs["spatial_edges"].numpy(), np.arange(STEPS + 1)[:, None] * DT
    for w in range(len(obs)):
        found = np.flatnonzero(crowd.seen[w] & (age[w] == 0.0))
        away = crowd.position[w, found] - obs.vehicle.position[w]
        order = np.argsort(np.linalg.norm(away, axis=1))
        for place, k in enumerate(order):
            expected = away[k] + ahead * crowd.velocity[w, found[k]]
            np.testing.assert_allclose(edges[w, place].reshape(-1, 2), expected, atol=1e-5)
        assert (edges[w, len(found) :] == AWAY).all()
        assert inputs["detected_human_num"][w, 0] == max(1, len(found))
        assert inputs["visible_masks"][w].numpy().tolist() == [k in found for k in range(6)]
    own = np.column_stack([obs.vehicle.position, obs.vehicle.radius, obs.vehicle.goal, obs.vehicle.preferred_speed])
    np.testing.assert_allclose(inputs["robot_node"][:, 0, :6], own, rtol=1e-5)
    assert shown(CrowdNavPlusPlanner(Network(numbers=2)), obs)["spatial_edges"].shape == (6, 6, 2)


def test_a_predictor_sees_five_positions_and_replaces_those_of_whom_it_knows():
    predictor, obs = Still(), crowded(2, 1)
    planner = CrowdNavPlusPlanner(Network(), predictor)
    edges = shown(planner, obs)["spatial_edges"].numpy()
    assert (predictor.past[:, 0, :-1] == UNKNOWN).all()
    assert predictor.seen[:, 0, :, 0].tolist() == [[0.0] * STEPS, [0.0] * (STEPS - 1) + [1.0]]
    np.testing.assert_allclose(predictor.past[1, 0, -1], obs.pedestrians.position[1, 0], rtol=1e-5)
    np.testing.assert_allclose(
        edges[1, 0, 2:].reshape(STEPS, 2), -obs.vehicle.position[1] * np.ones((STEPS, 1)), rtol=1e-5
    )
    planner.plan(obs)
    assert predictor.seen[1, 0, :, 0].tolist() == [0.0] * (STEPS - 2) + [1.0, 1.0]


def test_each_episode_has_a_memory_of_its_own():
    scenario = load_scenario("circle_crossing_5", {"time_limit": 5.0})
    planner = CrowdNavPlusPlanner(Network())
    trace = rollout(Driver(planner, "network"), scenario, Cases("val", 0, 5))
    angle = np.arctan2(trace.command[..., 1], trace.command[..., 0])
    for w in range(5):
        steps = np.arange(trace.steps[w])
        np.testing.assert_allclose(angle[w, : trace.steps[w]], np.arctan(0.1 * (steps + 1)), rtol=1e-5)
    np.testing.assert_allclose(np.nanmax(np.linalg.norm(trace.command, axis=2)), 1.0)


def test_too_many_people_and_other_objects_get_one_sentence():
    with pytest.raises(InputError, match="has act and base, but this Still has not"):
        CrowdNavPlusPlanner(Still())
    with pytest.raises(InputError, match="was made for 6 people, but here are 7"):
        shown(CrowdNavPlusPlanner(Network()), crowded(2, 7))


def test_an_incomplete_clone_and_an_unknown_model_get_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(InputError, match=r"no complete clone of CrowdNav\+\+, because it has no rl/networks/model.py"):
        adapter.planner(str(tmp_path))
    with pytest.raises(InputError, match=r"CrowdNav\+\+ has no trained model 'GST', but GST_predictor_non_rand,"):
        adapter.planner(str(tmp_path), "GST")
    trained = "trained_models/GST_predictor_rand"
    for file in (*adapter.CODE, f"{trained}/arguments.py", f"{trained}/configs/config.py"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    with pytest.raises(InputError, match=f"it has no {trained}/checkpoints/41665.pt: git clone"):
        adapter.planner(str(tmp_path), "GST_predictor_rand")


@pytest.mark.parametrize("weights", ["empty", "other", "code"])
def test_wrong_weights_get_one_sentence(weights, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    trained = tmp_path / "trained_models" / "GST_predictor_rand"
    texts = {
        adapter.CODE[0]: "class Policy: pass\n",
        adapter.CODE[1]: "",
        "trained_models/GST_predictor_rand/arguments.py": "def get_args(): pass\n",
        "trained_models/GST_predictor_rand/configs/config.py": "class Config: pass\n",
        "trained_models/GST_predictor_rand/checkpoints/41665.pt": "",
    }
    for file, text in texts.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    if weights != "empty":
        content = {"a": torch.zeros(1)} if weights == "other" else torch.nn.Linear(1, 1)
        torch.save(content, trained / "checkpoints" / "41665.pt")
    loaded = set(sys.modules)
    with pytest.raises(
        InputError, match=r"41665\.pt cannot be read, or holds something other than weights of GST_predictor"
    ) as error:
        adapter.planner(str(tmp_path), "GST_predictor_rand")
    for name in set(sys.modules) - loaded:
        monkeypatch.delitem(sys.modules, name)
    assert "\n" not in str(error.value)
