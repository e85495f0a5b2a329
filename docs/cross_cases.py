"""Makes the cases of the game on the start page: `python docs/cross_cases.py`.

The shipped planners drive them with realistic sensing. Pedestrians do not see the vehicle, so that their recorded
tracks are exact for any vehicle. The command keeps the runs in runs/cross, and writes a script for each case to
docs/cross/cases. Without these runs it takes a quarter of an hour.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.catalog import PLANNERS, load_planner, load_scenario
from crowdbench.core.types import Outcome, Trace
from crowdbench.export.replay_page import pack
from crowdbench.metrics.outcomes import t_empty
from crowdbench.metrics.score import score
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_run, load_stored_scenario
from crowdbench.runs.make import make_run
from crowdbench.runs.replay import stored_traces
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import crowd_decisions, move

ROOT = Path(__file__).parents[1]
FOLDER, RUNS = ROOT / "docs/cross/cases", ROOT / "runs/cross"
SCENARIO, CASES = "circle_20_blind", Cases("val", 0, 30)
SENSING = {"sensor.track": "realistic"}

FINE, COARSE = 1e-5, 2e-3
"""Resolution in metres of the tracks of pedestrians, on which contacts depend, and of planners."""


def walk(scenario: Scenario, cases: Cases) -> list[dict[str, Any]]:
    """Return the pedestrians of each case until the time limit: tracks, radii, and a flag for those that leave.

    The last position of a pedestrian that leaves is that of its arrival.
    """
    world = scenario.worlds(cases)
    people = world.present.shape[1] - 1
    tracks: list[list[list[np.ndarray]]] = [
        [[world.position[w, p + 1]] for p in range(people)] for w in range(len(world))
    ]
    radius = world.radius[:, 1:].copy()
    for _ in range(int(world.max_steps.max())):
        present = world.present[:, 1:]
        crowd, world = crowd_decisions(world, scenario.policies)
        after, _ = move(world, np.zeros((len(world), 2)), crowd)
        for w, p in np.argwhere(present).tolist():
            tracks[w][p].append(after.position[w, p + 1])
        assert scenario.post_step_rule is not None
        world = scenario.post_step_rule(after, np.ones(len(after), bool))
    left = ~world.present[:, 1:]
    return [{"tracks": tracks[w], "radius": radius[w].tolist(), "left": left[w]} for w in range(len(tracks))]


def drive(planner: str) -> Trace:
    """Return the trace of a planner, whose run is made unless it is there."""
    spec = RunSpec(planner, SCENARIO, CASES, overrides=SENSING, record="commands")
    make_run(load_run(spec), RUNS / planner, overwrite=False)
    (trace,) = stored_traces(RunResult.read(RUNS / planner), load_stored_scenario)
    return trace


def pack_track(track: np.ndarray, quantum: float) -> str:
    """Return the second differences of the positions of a track `[state, 2]` as a text."""
    points = np.round(track / quantum).astype(np.int64).T
    return pack(np.diff(np.diff(points, prepend=0), prepend=0))


def main() -> None:
    """Drive the planners, and write the cases."""
    names = [name for name, _ in PLANNERS.names() if not load_planner(name).privileged]
    scenario = load_scenario(SCENARIO, SENSING)
    crowds = walk(load_scenario(SCENARIO), CASES)
    traces = {name: drive(name) for name in names}
    first = next(iter(traces.values()))
    limits = scenario.worlds(CASES)
    FOLDER.mkdir(exist_ok=True, parents=True)
    scores = {name: score(trace) for name, trace in traces.items()}
    collided = []
    for w, case in enumerate(CASES.indices.tolist()):
        planners = [
            {
                "name": name,
                "outcome": Outcome(int(trace.outcome[w])).label,
                "steps": int(trace.steps[w]),
                "score": round(float(scores[name][w]), 3),
                "track": pack_track(trace.position[w, : trace.steps[w] + 1, 0], COARSE),
            }
            for name, trace in traces.items()
        ]
        crowd = crowds[w]
        data = {
            "case": f"val/{case}",
            "dt": scenario.rules.dt,
            "steps": int(limits.max_steps[w]),
            "least": float(t_empty(first)[w]),
            "start": limits.position[w, 0].tolist(),
            "goal": limits.goal[w, 0].tolist(),
            "speed": float(limits.preferred_speed[w, 0]),
            "radius": float(limits.radius[w, 0]),
            "people": [
                {"radius": radius, "left": int(left), "states": len(track), "track": pack_track(np.stack(track), FINE)}
                for track, radius, left in zip(crowd["tracks"], crowd["radius"], crowd["left"], strict=True)
            ],
            "planners": planners,
        }
        text = json.dumps(data, separators=(",", ":"))
        (FOLDER / f"{case}.js").write_text(f"cross.take({text})\n")
        collided.append(sum(planner["outcome"] == Outcome.COLLISION.label for planner in planners))
    sensor, detector = scenario.rules.sensor, scenario.rules.sensor.detector
    assert detector is not None
    about = {
        "scenario": SCENARIO,
        "collided": collided,
        "first": int(np.argmax(collided)),
        "sensor": {
            "range": sensor.range,
            "position": detector.position,
            "missed": detector.missed,
            "false": detector.false_detections,
            "radius": detector.radius,
        },
    }
    (FOLDER / "index.js").write_text(f"cross.about = {json.dumps(about)};\n")


if __name__ == "__main__":
    main()
