"""Compare episodes and metrics with recorded ones, to show that a change of the code moves no result.

python tests/golden/episodes.py             prints what differs from episodes.json; two minutes
python tests/golden/episodes.py SCENARIO    does so for one or more scenarios
python tests/golden/episodes.py --record    writes episodes.json anew
python tests/golden/episodes.py --record --planner mppi,hybrid    also if these planners drive otherwise than before

The file holds for the version of the simulator and for the digests of the scenarios that are in it. If an episode or a
metric of an unchanged scenario moves, `SIMULATOR` has to be raised before it is recorded again, unless only planners
that are named have moved.
Recorded people need CROWDBENCH_SHARED, and are left out without it.
"""

import argparse
import dataclasses
import hashlib
import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np

from crowdbench import METRICS, Cases, Outcome, load_planner, load_scenario, rollout
from crowdbench.catalog import PLANNERS, scenario_path, scenarios
from crowdbench.sim import SIMULATOR
from crowdbench.utils import read_toml

FILE = Path(__file__).with_suffix(".json")

IN_EVERY_SCENARIO = {"orca_margin": ("test:6", "val:3", "train:2"), "mppi": ("test:2",)}
"""The cases by planner. Of crowds of a thousand, only `orca_margin` drives one case of each split."""

OF_EVERY_PLANNER = {"circle_crossing_5": "test:2", "door_10": "test:1"}
"""The cases of every shipped planner, by scenario."""

SLOW = {
    *("mpc", "dra_mppi", "mppi_interactive", "mppi_sgan"),
    *("sarl_sgan", "sarl_sgan_kce", "sarl_sgan_kce_bounded", "sarl_sgan_seq"),
}
"""Planners that drive one case, of `circle_crossing_5` only."""

AMONG_WALLS = {"mppi_interactive"}
"""Slow planners that drive a case of each scenario: they plan otherwise among walls."""

ROUNDED = {"brne", "dra_mppi", "mpc"}
"""Planners without weights whose last bits depend on the processor, since they use libraries for linear algebra."""

MEASURED = ("circle_crossing_5", "circle_crossing_5_visible", "door_10", "car_28", "crowdnav_plus_20")
"""Scenarios with recorded metrics of `straight`, which collides, and of `orca_margin`."""

POPULATED = str(Path(__file__).parent.parent / "scenarios" / "populated.toml")
"""A scenario with a population, which no shipped scenario has."""

STEPS = 8
"""Steps after which the positions of the vehicle are compared, for planners whose last bits vary."""

MOVED = "moved, but its scenario is the same: if this is meant, raise SIMULATOR and record anew"


def digest(trace):
    """Return the digest of all arrays of a trace."""
    found = hashlib.sha256()
    for field in dataclasses.fields(trace):
        value = getattr(trace, field.name)
        if isinstance(value, np.ndarray):
            found.update(f"{field.name}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    return found.hexdigest()[:16]


def load(name):
    """Return a scenario with its tracks, None where they are not there."""
    if name == POPULATED or "tracks" not in read_toml(scenario_path(name), "scenario"):
        return load_scenario(name)
    if "CROWDBENCH_SHARED" not in os.environ:
        return None
    folder = "dut" if name.startswith("dut") else "eth_ucy"
    return load_scenario(name, data=Path(os.environ["CROWDBENCH_SHARED"]) / "data" / folder)


def episode(planner, scenario, cases):
    """Return what is recorded of some episodes: the digest of their trace, or outcomes and positions after a while."""
    made = load_planner(planner)
    trace = rollout(made, scenario, cases)
    if not made.facts and planner not in ROUNDED:
        return digest(trace)
    after = trace.position[:, min(STEPS, trace.position.shape[1] - 1), 0]
    return {"outcomes": [Outcome(outcome).label for outcome in trace.outcome], "after": after.round(6).tolist()}


def drives(scenario):
    """Yield the planners and cases of a scenario."""
    is_large = scenario.max_agents > 900
    for planner, texts in IN_EVERY_SCENARIO.items():
        for text in texts if not is_large or planner == "orca_margin" else ():
            cases = Cases.parse(text)
            yield planner, Cases(cases.split, 0, 1) if is_large else cases
    if scenario.name in OF_EVERY_PLANNER:
        yield from (
            (planner, cases_of(planner, scenario)) for planner in shipped() if drives_in(planner, scenario.name)
        )


def shipped():
    """Return the names of the shipped planners that can run here: MPC needs casadi."""
    return [name for name in PLANNERS.built_in() if name != "mpc" or importlib.util.find_spec("casadi")]


def drives_in(planner, scenario):
    """Return whether a planner is recorded in a scenario of `OF_EVERY_PLANNER`."""
    return planner not in SLOW - AMONG_WALLS or scenario == "circle_crossing_5"


def cases_of(planner, scenario):
    """Return the cases of a planner in a scenario of `OF_EVERY_PLANNER`."""
    return Cases("test", 0, 1) if planner in SLOW else Cases.parse(OF_EVERY_PLANNER[scenario.name])


def measure_metrics(scenario):
    """Return the values of all metrics in four cases of a scenario, by planner; None where one is undefined."""
    tables = {}
    for planner in ("straight", "orca_margin"):
        trace = rollout(planner, scenario, Cases("test", 0, 4), undisturbed=True)
        values = {name: np.asarray(metric(trace), float).tolist() for name, metric in METRICS.items()}
        tables[f"{scenario.name} {planner}"] = {
            name: [None if np.isnan(value) else value for value in row] for name, row in values.items()
        }
    return tables


def measure(names):
    """Return episodes and metrics of scenarios, and the digests of these scenarios."""
    found = {"simulator": SIMULATOR, "scenarios": {}, "episodes": {}, "metrics": {}}
    for name in names:
        if (scenario := load(name)) is None:
            continue
        found["scenarios"][scenario.name] = scenario.digest
        for planner, cases in drives(scenario):
            found["episodes"][f"{scenario.name} {cases} {planner}"] = episode(planner, scenario, cases)
        if name in MEASURED:
            found["metrics"] |= measure_metrics(scenario)
        print(scenario.name, flush=True)
    return found


def is_same(a, b):
    """Return whether two recordings agree: digests exactly, positions and metrics up to rounding."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    if a.get("outcomes") != b.get("outcomes") or a.keys() != b.keys():
        return False
    tolerance = {"atol": 1e-4} if "after" in a else {"rtol": 1e-9}
    numbers = [name for name in a if name != "outcomes"]
    return all(
        np.allclose(np.array(a[name], float), np.array(b[name], float), equal_nan=True, **tolerance) for name in numbers
    )


def differences(before, found):
    """Return a sentence for each difference between recorded and measured episodes and metrics."""
    if before["simulator"] != found["simulator"]:
        return [f"all is recorded for version {before['simulator']} of the simulator: record anew"]
    changed = [name for name, digest in found["scenarios"].items() if before["scenarios"].get(name) != digest]
    sentences = [f"{name} is a new or another scenario: record anew" for name in changed]
    for part in ("episodes", "metrics"):
        for key, value in found[part].items():
            if key.partition(" ")[0] in changed:
                continue
            if key not in before[part]:
                sentences.append(f"{key} is not recorded: record it")
            elif not is_same(before[part][key], value):
                sentences.append(f"{key} {MOVED}")
    return sentences


def is_planner_s(sentence, planners):
    """Return whether a difference is an episode of one of these planners."""
    return sentence.endswith(MOVED) and sentence.removesuffix(f" {MOVED}").split()[-1] in planners


def record(before, found):
    """Write what was measured beside what else is recorded."""
    if before["simulator"] == SIMULATOR:
        found |= {part: before[part] | found[part] for part in ("scenarios", "episodes", "metrics")}
    FILE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--planner", default="", help="planners that drive otherwise than before, as in a,b")
    given = parser.parse_args()
    names = given.scenarios or [*(name for name, _ in scenarios()), POPULATED]
    before, found = json.loads(FILE.read_text()), measure(names)
    told = differences(before, found)
    planners = given.planner.split(",")
    if given.record and all(is_planner_s(sentence, planners) for sentence in told if sentence.endswith(MOVED)):
        record(before, found)
    number = len(found["episodes"]) + len(found["metrics"])
    print(f"{number} episodes and tables were compared, and {len(told)} differ", *told, sep="\n")
    sys.exit(bool(told) or not number)
