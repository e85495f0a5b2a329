"""The study of cross-play: its crowds, its vehicles, its training, its figures and its page."""

import hashlib
import re
import sys

import numpy as np
import pytest

from crowdbench import InputError, load_planner, load_scenario, parallel_env, rollout
from crowdbench.catalog import PEDESTRIANS
from crowdbench.cli.app import main
from crowdbench.sim.simulator import crowd_decisions
from studies.cross_play import run as study
from studies.cross_play.strangers import self_play, standings
from studies.cross_play.train import SCENARIO, VIEW

PAIRS = study.TOGETHER
PAGE = (study.HERE / "README.md").read_text()
SEEDS = range(len(PAIRS))


@pytest.fixture(scope="module")
def onnx():
    return pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_crowd_acts_as_the_network_of_the_vehicle_does(onnx, seed):
    env = parallel_env(SCENARIO, **VIEW)
    seen, _ = env.reset(options={"case": "val/3"})
    policy = PEDESTRIANS.load("learned")[1]
    planner = load_planner(str(study.HERE / f"together-seed{seed}.onnx"))
    for _ in range(8):
        world = env._world
        velocity = policy.velocities(world, {"seed": np.full(world.radius.shape, float(seed))})[0]
        observed = np.stack([seen[agent] for agent in env.agents])
        actions = np.clip(planner.function(observed), -1.0, 1.0)
        after = env.step(dict(zip(env.agents, actions.astype(float), strict=True)))
        np.testing.assert_allclose(env._world.velocity[0, 1:], velocity, atol=1e-5)
        seen = after[0]


@pytest.mark.slow
def test_the_crowd_is_one_by_name():
    scenario = load_scenario(SCENARIO, pedestrians="learned")
    world = scenario.draw("val", np.arange(40))
    assert list(scenario.policies) == ["learned"]
    together = crowd_decisions(world, scenario.policies)[0]
    for case in (0, 17, 39):
        alone = crowd_decisions(world.take(np.array([case])), scenario.policies)[0]
        np.testing.assert_array_equal(alone[0], together[case])
    assert (np.linalg.norm(together, axis=2) <= world.preferred_speed[:, 1:] + 1e-12).all()


@pytest.mark.slow
def test_each_pedestrian_has_the_network_of_its_seed():
    def moves(seed):
        scenario = load_scenario(SCENARIO, {"pedestrians.learned.seed": seed}, "learned")
        world = scenario.draw("val", np.arange(5))
        return world.parameters["learned"]["seed"][:, 1:], crowd_decisions(world, scenario.policies)[0]

    each = np.stack([moves(seed)[1] for seed in SEEDS])
    assert len(np.unique(each.round(6), axis=0)) == len(SEEDS)
    seeds, mixed = moves({"low": 0, "high": 2})
    assert len(np.unique(seeds)) == len(SEEDS)
    for world, pedestrian in np.ndindex(seeds.shape):
        np.testing.assert_array_equal(mixed[world, pedestrian], each[int(seeds[world, pedestrian]), world, pedestrian])
    with pytest.raises(InputError, match=r"learned\.seed is 3, but must be 0 to 2"):
        moves(3)


@pytest.mark.slow
def test_the_networks_learned_two_conventions(onnx):
    """The agents near the centre move clockwise with seed 0, and counter-clockwise with seeds 1 and 2."""
    signs = []
    for seed, vehicle in enumerate(PAIRS):
        scenario = load_scenario(SCENARIO, {"pedestrians.learned.seed": seed}, "learned")
        trace = rollout(load_planner(str(study.HERE / f"{vehicle}.onnx")), scenario, "val:20")
        (x, y), (vx, vy) = np.moveaxis(trace.position, -1, 0), np.moveaxis(trace.velocity, -1, 0)
        near = trace.present & (np.hypot(x, y) < 2.0)
        signs.append(np.sign([(x * vy - y * vx)[..., agent][near[..., agent]].mean() for agent in range(x.shape[2])]))
    assert [set(each) for each in signs] == [{-1.0}, {1.0}, {1.0}]


def test_the_card_has_the_digest_of_each_network():
    card = (study.WEIGHTS / "learned.md").read_text()
    for seed in SEEDS:
        weights = (study.WEIGHTS / f"learned-seed{seed}.safetensors").read_bytes()
        assert f"| sha256 of seed {seed} | `{hashlib.sha256(weights).hexdigest()}` |" in card


# Figures.

KNOWN = {"a": ("x",), "b": ("y",), "free": ()}


def crossed(**rows):
    """Values in the crowds x, y and z, with errors of mean 0 over four cases."""
    error = np.array([-0.02, -0.01, 0.01, 0.02])
    return {name: {crowd: mean + error for crowd, mean in zip("xyz", row, strict=True)} for name, row in rows.items()}


def test_strangers_are_the_crowds_that_a_vehicle_does_not_know():
    scores = crossed(a=(0.9, 0.5, 0.3), b=(0.6, 0.1, 0.4), free=(0.9, 0.6, 0.6))
    delays = crossed(a=(0.0, 0.1, 0.2), b=(0.0, 0.0, 0.0), free=(0.0, 0.1, 0.2))
    delays["a"]["z"][1:] = np.nan  # -0.02 from the mean remains
    delays["free"]["x"][:] = np.nan
    found = standings(scores, delays, KNOWN)
    assert list(found) == ["free", "b", "a"]
    a, free = found["a"], found["free"]
    assert a.strangers.mean == pytest.approx(0.4)
    assert a.worst == (pytest.approx(0.3), "z")
    assert a.delay == pytest.approx((0.1 + 0.18) / 2.0)
    assert (a.known.mean, a.excess.mean) == pytest.approx((0.9, 0.5))
    assert (a.excess.low, a.excess.high) == pytest.approx((0.5, 0.5))  # paired by case
    assert a.familiarity.mean == pytest.approx(0.5 - 0.3)
    assert free.strangers.mean == pytest.approx(0.7)
    assert free.known.n == 0
    assert np.isnan(free.delay)


def test_self_play_is_a_mean_over_networks():
    scores = crossed(a=(0.9, 0.5, 0.3), b=(0.5, 0.7, 0.3), free=(0.6, 0.6, 0.3))
    means = {name: each.mean for name, each in self_play(scores, {"a": "x", "b": "y"}, KNOWN).items()}
    expected = {"own": 0.8, "strangers": 0.4, "excess": 0.4, "familiarity": 0.4 - 0.15}
    assert means == pytest.approx(expected)


# Page.


def read_table(page, heading):
    """The rows of a table of the page by their first cell, each by the headings."""
    section = page.split(f"## {heading}\n")[1].strip().split("\n\n")[0]
    header, _, *rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in section.splitlines()]
    return {row[0]: dict(zip(header, row, strict=True)) for row in rows}


def mean(cell):
    """The mean in a cell, without its mark and interval."""
    return float(re.search(r"-?[\d.]+", cell)[0])


def test_the_page_has_every_vehicle_in_every_crowd():
    for heading in ("Score", "At fault, %", "Imposed delay, %"):
        table = read_table(PAGE, heading)
        assert set(table) == set(study.KNOWN)
        assert all(tuple(row)[1:] == study.CROWDS for row in table.values())


def test_the_page_says_first_what_its_tables_say():
    vehicles, scores = read_table(PAGE, "Vehicles among strangers"), read_table(PAGE, "Score")
    first, safest = re.search(r"`([\w-]+)` is best among .+ (It also|`[\w-]+`) has the best score", PAGE).groups()
    assert first == next(iter(vehicles))
    assert f"mean score of {vehicles[first]['strangers']}." in PAGE
    worst = {name: mean(row["worst strangers"]) for name, row in vehicles.items()}
    assert worst[first if safest == "It also" else safest.strip("`")] == max(worst.values())
    own, strangers, gain = (float(re.search(rf"{words} (-?[\d.]+) ", PAGE)[1]) for words in SENTENCES)
    crowds = PAIRS.items()
    assert own == pytest.approx(np.mean([mean(scores[vehicle][crowd]) for vehicle, crowd in crowds]), abs=1e-3)
    assert strangers == pytest.approx(
        np.mean([mean(vehicles[vehicle]["strangers"]) for vehicle, _ in crowds]), abs=1e-3
    )
    assert gain == pytest.approx(own - strangers, abs=1e-3)
    foreign = [scores[vehicle][crowd] for vehicle, own in crowds for crowd in PAIRS.values() if crowd != own]
    assert f"scores from {min(map(mean, foreign)):.3f} to {max(map(mean, foreign)):.3f}." in PAGE


SENTENCES = "its crowd scores", "in this crowd, and", "overstates its score by"
"""Words before the score of self-play, the score among strangers, and their difference."""


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")
def test_all_networks_learn_and_the_page_has_a_row_for_each_vehicle(onnx, tmp_path, monkeypatch, capsys):
    pytest.importorskip("supersuit", reason="pip install supersuit")
    monkeypatch.setattr(study, "HERE", tmp_path)
    monkeypatch.setattr(study, "WEIGHTS", tmp_path)
    known = {"straight": (), study.WITH_ORCA: ("orca",), **{vehicle: (crowd,) for vehicle, crowd in PAIRS.items()}}
    monkeypatch.setattr(study, "KNOWN", known)
    monkeypatch.setattr(study, "CROWDS", ("orca", *PAIRS.values()))
    monkeypatch.setattr(sys, "argv", ["run.py", "--train", "0.05", "--cases", "val:4", "--out", str(tmp_path / "runs")])
    with pytest.raises(SystemExit) as stop:
        main(study.cross_play)
    assert not stop.value.code
    made = {path.name for path in tmp_path.iterdir() if path.is_file()}
    networks = {f"{vehicle}.onnx" for vehicle in (*PAIRS, study.WITH_ORCA)}
    assert made == networks | {f"{crowd}.safetensors" for crowd in PAIRS.values()}
    page = capsys.readouterr().out
    assert page.startswith("Printed by `python studies/cross_play/run.py --cases val:4`.")
    assert set(read_table(page, "Score")) == set(known)
