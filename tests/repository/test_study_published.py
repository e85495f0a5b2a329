"""The study of published networks: its runs, and what it says of the people of a training."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import save_file
from study_folders import cells, episodes, leave
from typer.testing import CliRunner

from crowdbench import load_scenario, rollout
from crowdbench.cli.app import build_script
from crowdbench.networks.value import NETWORKS
from crowdbench.networks.weights import save_network
from crowdbench.plugins.kind import load_module
from crowdbench.scenario.cases import Cases
from studies.published.run import published
from studies.published.table import DS_RNN, KINDS, PEOPLE, SCENES, PublishedTable, ScenariosSpec

FOLDER = Path(__file__).parents[2] / "studies" / "published"
CASES = 10


@pytest.fixture
def networks(tmp_path):
    """A folder with untrained networks under the names of the published ones."""
    adapter = load_module(DS_RNN)
    for kind, people, scene in itertools.product(KINDS, PEOPLE, SCENES):
        save_network(NETWORKS[kind](), kind, tmp_path / f"{scene}__{kind}_on_{people}.safetensors", {})
    theirs = {ours: name for name, ours in adapter.LAYERS.items()}
    cells = ("node", "temporal", "spatial")
    named = ((*key.rpartition(".")[::2], tensor) for key, tensor in adapter.DSRNN().state_dict().items())
    state = {f"base.{theirs[layer]}.{part}{'_l0' * (layer in cells)}": tensor for layer, part, tensor in named}
    save_file(
        {key.replace("base.dist", "dist"): tensor for key, tensor in state.items()}, tmp_path / "dsrnn.safetensors"
    )
    return tmp_path


@pytest.mark.slow
def test_networks_trained_among_others_are_compared_with_those_trained_among_orca(networks, tmp_path):
    scenarios = ["circle_crossing_5", "square_crossing_5"]
    spec = ScenariosSpec(title="Mine", scenarios=scenarios, predictor="constant_velocity", cases=f"val:{CASES}")
    table = PublishedTable.load(spec, networks)
    half, out = np.arange(CASES) < CASES // 2, tmp_path / "runs"
    for name, runs in table.by_network.items():
        for run in runs:
            leave(run, out, episodes(np.ones(CASES, bool) if ", social force" in name else half))
    filled = table.fill(out)
    rows = {row[0]: row[1:] for row in cells(filled.markdown())}
    assert rows["network"] == scenarios
    assert rows["sarl, social force, both"] == ["100.0 (0.0)"] * 2
    assert rows["cadrl, ORCA, traffic"] == rows["ds_rnn"] == rows["lstm_rl, ours"] == ["50.0 (0.0)"] * 2
    assert len(rows) == 27 + 3 + 1 + 4  # the two headers, and the two differences
    assert rows["trained among"] == ["all", *KINDS]
    assert [cell.partition(" ")[0] for cell in rows["social force instead of ORCA"]] == ["50.0"] * 4
    assert rows["headed social force instead of ORCA"] == ["0.0 (0.0 to 0.0)"] * 4


def test_value_networks_are_driven_with_the_predictor_of_the_table(networks):
    spec = ScenariosSpec(title="Mine", scenarios=["circle_crossing_5"], predictor="oracle", cases="val:2")
    table = PublishedTable.load(spec, networks)
    privileged = {name for name, (run,) in table.by_network.items() if run.driver.privileged}
    assert privileged == set(table.by_network) - {"ds_rnn"}
    weights = {run.driver.facts["weights"] for (run,) in table.by_network.values()}
    assert len(weights) == len(table.by_network)


def test_a_folder_without_the_networks_gets_one_sentence(tmp_path):
    done = CliRunner().invoke(build_script(published), [str(tmp_path), "--out", str(tmp_path / "runs")])
    assert "circular_crossing__sarl_on_orca.safetensors cannot be read" in str(done.exception)
    assert "\n" not in str(done.exception)


@pytest.mark.parametrize("people", ["orca", "social_force"])
def test_the_stream_comes_towards_the_vehicle_and_in_again_at_its_right_end(people):
    scenario = load_scenario(str(FOLDER / f"traffic_{people}.toml"), {"time_limit": 12.0})
    start = scenario.draw("val", np.arange(20))
    assert (start.position[:, 0] == [-6.0, 0.0]).all()
    assert (np.abs(start.position[:, 1:]) <= [7.0, 1.5]).all()
    seen = []
    rollout("straight", scenario, Cases("val", 0, 20), watch=seen.append)
    before, after = seen[:-1], seen[1:]
    came = 0
    for one, two in zip(before, after, strict=True):
        if len(one) != len(two):
            continue  # a world has ended
        new = two.person != one.person
        came += int(new.sum())
        assert (one.position[:, 1:, 0][new] < -6.0).all()
        assert (two.position[:, 1:, 0][new] >= 7.0).all()
        assert (np.abs(two.position[:, 1:, 1][new]) <= 1.5).all()
    assert came > 5
    assert min(world.position[:, 1:, 0].min() for world in seen) > -8.5
