"""Command lines, networks, cards, studies, environments and arguments of Python at random: one sentence for each.

See `fuzzing` for more examples.
"""

import contextlib
import json
import shutil
import warnings
from pathlib import Path
from unittest import mock

import gymnasium
import numpy as np
import pytest
import typer
from fuzzing import BYTES, EDITS, FIELDS, TOKENS, VALUES, answer, edit_bytes, edit_json, edit_text, fuzz, log
from helpers import make
from hypothesis import given
from hypothesis import strategies as st

import crowdbench
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli import app as cli
from crowdbench.envs.registration import VEHICLE
from crowdbench.record import viewer
from crowdbench.utils.errors import InputError

ROOT = Path(__file__).parents[2]

WORDS = st.sampled_from(
    [
        *(token for token in TOKENS if "\0" not in token and "test:0:1" not in token),
        *("val/0", "val:1", "a", "b", "jerk", "success_rate", "circle_crossing_5", "door_10", "social_force", "pdf"),
        *(
            "10",
            "3.7",
            "1e-9",
            "true",
            "all",
            "none",
            "csv",
            "latex",
            "planners",
            "unicycle",
            "respawn",
            "out",
            "x.gif",
        ),
    ]
)
KEYS = (
    *("time_limit", "dt", "seed", "vehicle.radius", "vehicle.dynamics", "vehicle.visible", "vehicle.preferred_speed"),
    *("pedestrians.number", "pedestrians.radius", "pedestrians.policy", "pedestrians.arrival", "pedestrians.groups"),
    *("pedestrians.clear_space", "sensor.range", "sensor.lidar", "sensor.delay", "layout.generator", "layout", "x.y"),
    *("layout.circle_radius", "crowdnav_cases", "collision", "pedestrians.orca.time_horizon", "safety_space"),
)

BASES = {
    "run": ["--planner", "orca", "--cases", "val:2", "--set", "time_limit=3.0", "--out", "out", "--overwrite"],
    "check": ["success_rate", "--kind", "metrics", "--cases", "val:2"],
    "suite": ["nothing", "--cases", "1"],
    "cross": ["nothing", "orca", "--cases", "1"],
    "train": ["ppo", "--out", "a", "--steps", "-1"],
    "merge": ["a", "b", "--out", "out", "--overwrite"],
    "new-planner": ["mine", "--out", "planners"],
    "list": ["planners", "orca"],
    "view": ["a"],
    "render": ["a", "--case", "1", "--out", "x.svg"],
    "plot": ["success", "a", "--out", "x.svg"],
    "table": ["a", "a"],
    "compare": ["a", "a"],
    "score": ["a"],
    "export": ["a", "--out", "tracks", "--overwrite"],
}
"""A valid command line of each command, apart from `suite` and `train`, which take long."""

LONG = ("--workers", "--engine", "--threads", "--isolated", "--shard", "--minutes", "--steps", "--episodes", "--help")
"""Options that start processes or threads, or that take long with a valid value."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    for name, cases in (("a", "2"), ("b", "2:4")):
        make(folder / name, load_planner("orca"), load_scenario("circle_crossing_5"), cases, record="all")
    return folder


def options_of(command):
    """The options of a command; true for those that take no value."""
    found = typer.main.get_command(cli.build_app(command)).commands[command].params
    return {name: item.is_flag for item in found if item.param_type_name == "option" for name in item.opts}


@st.composite
def command_lines(draw):
    command = draw(st.sampled_from(sorted(BASES)))
    line = [command, *BASES[command]]
    known = {name: is_flag for name, is_flag in options_of(command).items() if name not in LONG}
    for option in draw(st.lists(st.sampled_from(sorted(known)), max_size=3)) if known else []:
        value = draw(WORDS)
        if option in ("--set", "--option", "--ppo"):
            value = f"{draw(st.sampled_from(KEYS))}={value}"
        line += [option] if known[option] else [option, value]
    if draw(st.booleans()):
        line[draw(st.integers(1, len(line) - 1))] = draw(WORDS)
    return line


@fuzz
@given(command_lines())
def test_command_lines(folder, line):
    with contextlib.chdir(folder), mock.patch.object(viewer, "view"):
        answer(*line)
        for name in ("planners", "runs"):
            shutil.rmtree(name, ignore_errors=True)


@pytest.fixture(scope="module")
def weights(folder):
    for path in (ROOT / "agents" / "weights").glob("ppo-seed1.*"):
        shutil.copy(path, folder / f"sound{path.suffix}")
    return folder


def drive_with(folder, name):
    answer("run", "--planner", "ppo", "--option", f"weights={folder / name}", "--cases", "val:2", "--set",
           "time_limit=2.0", "--record", "none", "--out", folder / "driven", "--overwrite")  # fmt: skip


@fuzz
@given(BYTES)
def test_weights(weights, edits):
    shutil.copy(weights / "sound.json", weights / "mine.json")
    (weights / "mine.safetensors").write_bytes(edit_bytes((weights / "sound.safetensors").read_bytes(), edits))
    drive_with(weights, "mine.safetensors")


@fuzz
@given(FIELDS)
def test_cards_of_weights(weights, edits):
    shutil.copy(weights / "sound.safetensors", weights / "mine.safetensors")
    card = edit_json(json.loads((weights / "sound.json").read_text()), edits)
    (weights / "mine.json").write_bytes(json.dumps(card).encode("utf-8", "replace"))
    drive_with(weights, "mine.safetensors")


@fuzz
@given(BYTES)
def test_onnx(folder, edits):
    pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")
    sound = (ROOT / "studies" / "cross_play" / "together-seed0.onnx").read_bytes()
    (folder / "mine.onnx").write_bytes(edit_bytes(sound, edits))
    answer("run", "--planner", folder / "mine.onnx", "--cases", "val:2", "--set", "time_limit=2.0", "--record", "none",
           "--out", folder / "driven", "--overwrite")  # fmt: skip


@fuzz
@given(EDITS)
def test_studies(folder, edits):
    from studies.tables import read_tables

    text = (ROOT / "docs" / "paper.md").read_text()
    examples = [block.partition("```")[0] for block in text.split("```toml\n")[1:]]
    (folder / "study.toml").write_text(edit_text("\n".join(examples), edits), errors="replace")
    log(edits)
    with contextlib.suppress(InputError):
        read_tables(folder / "study.toml", None)


UNCHECKED = {"disable_env_checker": True}

NUMBERS = st.integers(-2, 64) | st.sampled_from([True, None, 0.5, "x", [], 2**63, float("nan")])
NAMES = st.sampled_from(
    ["", "x", "flat", "dict", "goal_frame", "velocity", "native", "progress", "crowdnav", "/dev/zero"]
)
ARGUMENTS = st.fixed_dictionaries(
    {},
    optional={
        "observation": NAMES | VALUES,
        "action": NAMES | VALUES,
        "reward": NAMES | VALUES,
        "nearest": NUMBERS.filter(lambda number: number != 2**63),
        "rays": NUMBERS.filter(lambda number: number != 2**63),
    },
)
ACTIONS = st.sampled_from(
    [
        None,
        1,
        [1.0],
        [0.5, 0.5],
        [[0.5, 0.5]],
        [[0.1, 0.2]] * 2,
        [float("nan"), 0.0],
        [1e308, 1e308],
        [],
        {},
        "ab",
        True,
    ]
)
RESETS = st.none() | st.dictionaries(
    st.sampled_from(["case", "reset_mask", "x"]), VALUES | st.sampled_from(["val/3", "train/-1", ["val/1", "val/2"]])
)


@fuzz
@given(st.sampled_from(["gym", "vector", "pettingzoo"]), ARGUMENTS, NUMBERS, RESETS, ACTIONS)
@pytest.mark.filterwarnings("ignore")
def test_environments(kind, arguments, seed, options, action):
    log((kind, arguments, seed, options, action))
    with contextlib.suppress(ValueError, gymnasium.error.Error), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if kind == "pettingzoo":
            env, action = crowdbench.parallel_env("door_10", **arguments), {"vehicle": action}
        else:
            # The checker of Gymnasium itself fails after a reset that was refused.
            make, more = (gymnasium.make_vec, {"num_envs": 2}) if kind == "vector" else (gymnasium.make, UNCHECKED)
            env = make(VEHICLE, scenario="door_10", **arguments, **more)
        with contextlib.suppress(ValueError, gymnasium.error.Error):
            env.reset(seed=seed, options=options)
        env.reset(seed=0)
        with contextlib.suppress(ValueError, gymnasium.error.Error):
            env.step(action)


PYTHON = st.fixed_dictionaries(
    {},
    optional={
        "cases": st.integers(-2, 3) | st.sampled_from(["", "val:2", "x", "val/1", "9" * 30]),
        "options": st.dictionaries(st.sampled_from(["safety_space", "filter", "x", ""]), VALUES, max_size=2),
        "overrides": st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=2),
        "pedestrians": st.sampled_from(["orca", "x", "", "./mine.py", "recorded", "stop_and_go"]),
        "record": st.sampled_from(["none", "all", "", "x"]),
        "key": st.sampled_from(["", "x", "é\0"]),
        "data": st.sampled_from(["", "x", "/dev/null", Path()]),
        "scenario": st.sampled_from(["door_10", "", "x", "./x.toml", "/dev/zero", "circle_crossing_5"]),
    },
)


@fuzz
@given(st.sampled_from(["orca", "straight", "", "x", "./mine.py", "/dev/null"]), PYTHON)
def test_arguments_of_python(folder, planner, arguments):
    log((planner, arguments))
    shutil.rmtree(folder / "python", ignore_errors=True)
    arguments = {"cases": 2, **arguments}
    arguments["overrides"] = {"time_limit": 2.0, **arguments.get("overrides", {})}
    with contextlib.suppress(InputError), contextlib.chdir(folder), np.errstate(all="ignore"):
        crowdbench.run(planner, out="python", progress=lambda step: None, **arguments)
