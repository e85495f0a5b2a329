"""Compare the episodes of every scenario with recorded digests, to show that a change moves no bit.

python tests/golden/episodes.py             prints which episodes differ from episodes.json; a minute
python tests/golden/episodes.py SCENARIO    does so for one or more scenarios
python tests/golden/episodes.py --record    writes episodes.json anew, after a change that is meant

Recorded people need CROWDBENCH_SHARED, and are left out without it.
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


def load(name):
    """Return a scenario with its tracks, None where they are not there."""
    if "tracks" not in read_toml(scenario_path(name), "scenario"):
        return load_scenario(name)
    if "CROWDBENCH_SHARED" not in os.environ:
        return None
    folder = "dut" if name.startswith("dut") else "eth_ucy"
    return load_scenario(name, data=Path(os.environ["CROWDBENCH_SHARED"]) / "data" / folder)


def measure(names):
    """Return the digest of each drive by scenario, cases and planner."""
    found = {}
    for name in names:
        if (scenario := load(name)) is None:
            continue
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
    names = [name for name in sys.argv[1:] if name != "--record"] or [name for name, _ in scenarios()]
    found = measure(names)
    before = json.loads(FILE.read_text())
    if "--record" in sys.argv:
        FILE.write_text(json.dumps(before | found, indent=1) + "\n")
    differ = [name for name in found if before.get(name) != found[name]]
    print(f"{len(found) - len(differ)} of {len(found)} are equal", *differ, sep="\n")
    sys.exit(bool(differ) or not found)
