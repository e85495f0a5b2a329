"""Compare the episodes of every scenario with recorded digests, to show that a change moves no bit.

python tests/golden/episodes.py             prints which scenarios differ from episodes.json; some minutes
python tests/golden/episodes.py --record    writes episodes.json anew, after a change that is meant

Digests are those of one machine and one set of versions (constraints.txt). Recorded people need CROWDBENCH_SHARED.
"""

import dataclasses
import hashlib
import json
import os
import sys
from pathlib import Path

import numpy as np

from crowdbench import Driver, load_planner, load_scenario, rollout
from crowdbench.catalog import scenario_path, scenarios
from crowdbench.scenario.cases import Cases
from crowdbench.utils.toml import read_toml

FILE = Path(__file__).with_suffix(".json")
DRIVES = {"orca_margin": ("test:6", "val:3", "train:2"), "mppi": ("test:2",)}
"""The cases by planner. Of crowds of a thousand, only `orca_margin` drives one case of each split."""


def digest(trace):
    """Return the digest of all arrays of a trace."""
    found = hashlib.sha256()
    for field in dataclasses.fields(trace):
        value = getattr(trace, field.name)
        if isinstance(value, np.ndarray):
            found.update(f"{field.name}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    return found.hexdigest()[:16]


def data_of(name):
    """Return the folder with the tracks of a scenario, None where it needs none."""
    if "tracks" not in read_toml(scenario_path(name), "scenario"):
        return None
    return Path(os.environ["CROWDBENCH_SHARED"]) / "data" / ("dut" if name.startswith("dut") else "eth_ucy")


def measure():
    """Return the digest of each drive by scenario, cases and planner."""
    found = {}
    for name, _ in scenarios():
        scenario = load_scenario(name, data=data_of(name))
        is_large = scenario.max_agents > 900
        for planner, drives in DRIVES.items():
            for text in drives if not is_large or planner == "orca_margin" else ():
                cases = Cases.parse(text)
                cases = Cases(cases.split, 0, 1) if is_large else cases
                trace = rollout(Driver(load_planner(planner)[1], planner), scenario, cases)
                found[f"{name} {cases} {planner}"] = digest(trace)
        print(name, flush=True)
    return found


if __name__ == "__main__":
    found = measure()
    if "--record" in sys.argv:
        FILE.write_text(json.dumps(found, indent=1) + "\n")
    before = json.loads(FILE.read_text())
    differ = [name for name in before | found if before.get(name) != found.get(name)]
    print(f"{len(found) - len(differ)} of {len(before)} are equal", *differ, sep="\n")
    sys.exit(bool(differ))
