"""Recompute metrics in NumPy from the files that `crowdbench export` writes."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from helpers import drive, make
from scipy.spatial.distance import cdist

from crowdbench.catalog import load_scenario
from crowdbench.export.tracks import export_tracks
from crowdbench.metrics.registry import METRICS
from crowdbench.results.episodes import Episodes
from crowdbench.results.run_result import RunResult

DT, RADIUS, SPEED, LIMIT = 0.25, 0.3, 1.0, 25.0
"""Of the scenario: seconds, metres, m/s of everybody, and the time limit in seconds."""

UNTOLD = np.inf
"""The six digits of the tracks do not tell the direction of so short a step."""

ELSEWHERE = {"clearing_distance", "wall_collision_rate", "group_intrusion", "at_fault_seen_rate"}
"""Recomputed in other scenarios, which have walls, groups and pedestrians who look around."""


def tracks(folder, planner="orca", cases="val:15", **visible):
    """The table of episodes of a run, the positions `[frame, agent, 2]` of its cases, and the rewards of each."""
    scenario = load_scenario("circle_crossing_5", visible)
    make(folder / "run", planner, scenario, cases)
    (folder / "export").mkdir()
    export_tracks(RunResult.read(folder / "run"), lambda _: scenario, folder / "export")
    episodes = Episodes.read(folder / "run" / "episodes.csv")
    steps = pq.read_table(folder / "export" / "steps.parquet").to_pydict()
    found, rewards = [], []
    for case in episodes.case.tolist():
        frame, agent, x, y = np.loadtxt(folder / "export" / "tracks" / f"val-{case}.txt").T
        positions = np.full((int(frame.max()) + 1, 6, 2), np.nan)
        positions[frame.astype(int), agent.astype(int)] = np.stack([x, y], axis=1)
        found.append(positions)
        rewards.append(np.array(steps["reward"])[np.array(steps["case"]) == case])
    return episodes.columns, found, rewards


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return tracks(tmp_path_factory.mktemp("seen"), **{"vehicle.visible": True})


@pytest.fixture(scope="module")
def unseen(tmp_path_factory):
    return tracks(tmp_path_factory.mktemp("unseen"))


@pytest.fixture(scope="module")
def stops(tmp_path_factory):
    return tracks(tmp_path_factory.mktemp("stops"), "social_force", "val:6")


def norm(vector):
    return np.linalg.norm(vector, axis=-1)


def gaps(p):
    """The smallest gap `[step, pedestrian]` while all move straight in a step, in metres."""
    offset = p[:, 1:] - p[:, :1]
    share = np.linspace(0, 1, 2001)[:, None, None, None]
    return norm((1 - share) * offset[:-1] + share * offset[1:]).min(axis=0) - 2 * RADIUS


def seconds_close(p):
    """Seconds close to pedestrians: at gaps up to 0.3 m fully, at 0.6 m not at all."""
    offset = p[:, 1:] - p[:, :1]
    share = (np.arange(2000)[:, None, None, None] + 0.5) / 2000
    gap = norm((1 - share) * offset[:-1] + share * offset[1:]) - 2 * RADIUS
    return DT * np.clip((0.6 - gap) / 0.3, 0.0, 1.0).mean(axis=0).sum()


def times(p):
    """The time to collision `[step, pedestrian]` at the velocity of the step, on a grid of 1 ms up to 1.5 s."""
    offset, velocity = (p[:, 1:] - p[:, :1])[:-1], np.diff(p[:, 1:] - p[:, :1], axis=0) / DT
    grid = np.arange(0.0, 1.5, 1e-3)
    touches = norm(offset[..., None, :] + grid[:, None] * velocity[..., None, :]) < 2 * RADIUS
    return np.where(touches.any(axis=2), grid[touches.argmax(axis=2)], np.inf)


def at(p, time):
    """The positions at times in steps."""
    early = np.clip(np.floor(time).astype(int), 0, len(p) - 2)
    return p[early] + (time - early)[:, None, None] * (p[early + 1] - p[early])


def ends(p, reward):
    """How the episode ended, when, and what it was rewarded."""
    hits = gaps(p).min() < 0.0
    success = not hits and norm(p[-1, 0] + p[0, 0]) < RADIUS  # the goal is opposite on the circle
    time, length = (len(p) - 1) * DT, norm(np.diff(p[:, 0], axis=0)).sum()
    shortest = 2 * norm(p[0, 0]) - RADIUS
    least = np.ceil(shortest / SPEED / DT) * DT
    began, since, failures = norm(p[0, 0] + p[0, 0]), 0, 0
    for t in range(1, len(p)):
        nearer, late = began - norm(p[t, 0] + p[0, 0]) >= 0.5, t - since >= 5.0 / DT
        failures += late and not nearer
        if nearer or late:
            began, since = norm(p[t, 0] + p[0, 0]), t
    return {
        "success_rate": success,
        "collision_rate": hits,
        "person_collision_rate": hits,
        "timeout_rate": not hits and not success,
        "navigation_time": time if success else np.nan,
        "navigation_time_or_limit": time if success else LIMIT,
        "t_empty": least,
        "t_close": seconds_close(p) if success else np.nan,
        "score": success * least / (max(time, least) + seconds_close(p)),
        "path_length": length,
        "success_path_length": length if success else np.nan,
        "spl": success * shortest / max(length, shortest),
        "sct": success * least / max(time, least),
        "failures_to_progress": failures,
        "discounted_return": (0.9 ** (np.arange(len(p) - 1) * DT * SPEED) * reward).sum(),
    }


def distances(p, success):
    """How near the vehicle came to pedestrians, over successes but for the measures of CrowdNav and CrowdNav++."""
    gap, steps = gaps(p).min(axis=1), len(p) - 1
    ahead = np.full((steps, 5), np.inf)
    for t in range(steps):
        for k in range(1, min(6, len(p) - t)):
            ahead[t, k - 1] = norm(p[t + k, 1:] - p[t, 0]).min()
    intrusion = ahead.min(axis=1)[ahead.min(axis=1) < 0.6]
    near = gap < 1.2
    found = {
        "minimum_gap": gap.min(),
        "discomfort": (gap < 0.2).mean(),
        "personal_space_compliance": (gap >= 0.5).mean(),
        "intimate_zone": (gap < 0.45).mean(),
        "personal_zone": near.mean(),
        "social_zone": (gap < 3.6).mean(),
        "speed_near_pedestrians": norm(np.diff(p[:, 0], axis=0))[near].mean() / DT if near.any() else np.nan,
        "social_work": social_work(p),
    }
    return {name: value if success else np.nan for name, value in found.items()} | {
        "discomfort_frequency": (gap[:-1] < 0.2).sum() / steps,
        "intrusion_time_ratio": len(intrusion) / steps,
        "social_distance": intrusion.mean() if len(intrusion) else np.nan,
    }


def force(between, relative):
    """The social force of Moussaïd et al. (2009) in m/s^2, with the parameters of HuNavSim."""
    direction = between / norm(between)
    interaction = 2.0 * relative + direction
    ahead, size = interaction / norm(interaction), 0.35 * norm(interaction)
    angle = np.arctan2(direction @ [-ahead[1], ahead[0]], direction @ ahead)
    brakes = np.exp(-norm(between) / size - (3.0 * size * angle) ** 2)
    turns = np.sign(angle) * np.exp(-norm(between) / size - (2.0 * size * angle) ** 2)
    return -2.1 * (brakes * ahead + turns * np.array([-ahead[1], ahead[0]]))


def social_work(p):
    """The sizes of the forces on the vehicle and by it, over time."""
    velocity, work = np.diff(p, axis=0) / DT, 0.0
    for q, v in zip(p[1:], velocity, strict=True):
        work += norm(sum(force(q[i] - q[0], v[0] - v[i]) for i in range(1, 6)))
        work += sum(norm(force(q[0] - q[i], v[i] - v[0])) for i in range(1, 6))
    return work * DT


def motion(p, success):
    """Accelerations, turns and stops."""
    v = np.concatenate([np.zeros((1, 2)), np.diff(p[:, 0], axis=0) / DT])
    speed, change = norm(v[1:]), norm(np.diff(v, axis=0))
    heading = np.arctan2(v[1:, 1], v[1:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)[(speed[1:] >= 0.05) & (speed[:-1] >= 0.05)]
    step = v[1:][speed > 1e-5 / DT]
    faces = np.concatenate([[np.arctan2(*-p[0, 0, ::-1])], np.arctan2(step[:, 1], step[:, 0])])
    turned = np.abs((np.diff(faces) + np.pi) % (2 * np.pi) - np.pi).sum()
    if ((speed > 1e-6 / DT) & (speed < 1e-3)).any():
        turned = UNTOLD
    stopped, length = (speed < 0.05).sum() * DT, norm(np.diff(p[:, 0], axis=0)).sum()
    return {
        "max_velocity_change": change.max(),
        "max_acceleration": change.max() / DT,
        "mean_acceleration": change.mean() / DT,
        "jerk": norm(np.diff(v, n=2, axis=0)).mean() / DT**2,
        "max_turn": turn.max(initial=0.0),
        "cumulative_heading_change": turned,
        "success_heading_change": turned if success else np.nan,
        "path_irregularity": turned / length if success else np.nan,
        "stopped_time": stopped,
        "success_stopped_time": stopped if success else np.nan,
        "frozen_time": sum(is_open(p, t) for t in np.flatnonzero(speed < 0.05) if t + 2.0 / DT <= len(p) - 1) * DT,
    }


def is_open(p, t):
    """Whether the straight way to the goal at 1 m/s keeps 0.2 m from the pedestrians, for 2 s or up to the goal."""
    way = -p[0, 0] - p[t, 0]
    after = np.linspace(0.0, min(2.0, norm(way) / SPEED), 2001)
    own = p[t, 0] + after[:, None] * SPEED * way / norm(way)
    return norm(at(p, t + after / DT)[:, 1:] - own[:, None]).min() - 2 * RADIUS >= 0.2


def contact(p, hits):
    """Whose fault a collision was."""
    shares = dict.fromkeys(("at_fault_rate", "hit_alone_rate", "hit_both_rate"), False)
    struck = dict.fromkeys(("struck_standing_rate", "struck_behind_rate", "struck_otherwise_rate"), False)
    if not hits:
        return shares | struck | {"vehicle_share": np.nan, "impact_speed": np.nan}
    last = len(p) - 2 + np.linspace(0.0, 1.0, 100001)
    touches = norm(at(p, last)[:, 1:] - at(p, last)[:, :1]) < 2 * RADIUS
    time, who = last[touches.any(axis=1).argmax()], 1 + touches[touches.any(axis=1).argmax()].argmax()
    window = np.linspace(max(time - 1.0 / DT, 0.0), time, 4001)
    moved = np.diff(at(p, window), axis=0)
    middle = at(p, (window[1:] + window[:-1]) / 2)
    normal = middle[:, who] - middle[:, 0]
    normal /= norm(normal)[:, None]
    own = np.maximum((moved[:, 0] * normal).sum(axis=1), 0.0).sum()
    share = own / (own + np.maximum(-(moved[:, who] * normal).sum(axis=1), 0.0).sum())
    stands = norm(moved[:, 0]).sum() < 0.05
    step = np.diff(p[:, 0], axis=0)[norm(np.diff(p[:, 0], axis=0)) > 1e-5]
    behind = normal[-1] @ (step[-1] / norm(step[-1])) < np.cos(np.radians(120.0))
    velocity = (p[-1] - p[-2]) / DT
    return {
        "at_fault_rate": share >= 0.1,
        "hit_alone_rate": not stands and share > 0.9,
        "hit_both_rate": not stands and 0.1 <= share <= 0.9,
        "struck_standing_rate": stands,
        "struck_behind_rate": not stands and share < 0.1 and behind,
        "struck_otherwise_rate": not stands and share < 0.1 and not behind,
        "vehicle_share": share,
        "impact_speed": norm(velocity[who] - velocity[0]),
    }


def encounters(p, success):
    """Near misses, the time to collision where it is below 1.5 s, and the time between two on the same place."""
    gap, time, met, near = gaps(p), times(p), 0, 0
    for i in range(5):
        for begin, end in np.flatnonzero(np.diff(np.concatenate([[0], gap[:, i] < 3.6, [0]]))).reshape(-1, 2):
            met += 1
            near += bool((gap[begin:end, i] < 0.2).any() or (time[begin:end, i] < 1.0).any())
    moments = np.arange(0, len(p) - 1 + 1e-9, 0.05)
    between = at(p, moments)
    apart = np.stack([cdist(between[:, 0], between[:, i]) for i in range(1, 6)], axis=2)
    s, t, _ = np.nonzero(apart < 2 * RADIUS)
    found = {
        "time_to_collision": time.min(),
        "near_misses": near / met if met else np.nan,
        "near_misses_per_hour": near * 3600 / (5 * (len(p) - 1) * DT),
        "post_encroachment_time": np.abs(s - t).min() * 0.05 * DT if len(s) else np.nan,
        "paths_apart": len(s) == 0,
    }
    return {name: value if success else np.nan for name, value in found.items()}


def costs(p, alone):
    """What pedestrians lose to a vehicle that they see, beside those who do not; as long as both are there."""
    both = np.stack([p, alone[: len(p)]])[:, :, 1:]
    distance = norm(both + both[0, 0]) - RADIUS  # goals are opposite on the circle
    lost, matched, detour = np.zeros((3, 5))
    for i in range(5):
        arrived = np.flatnonzero((distance[:, :, i] < 0.0).any(axis=0))
        end = arrived[0] if len(arrived) else distance.shape[1] - 1
        further = np.subtract(*np.maximum(distance[:, end, i], 0.0))
        lost[i], matched[i] = further / SPEED, end * DT
        detour[i] = further + np.subtract(*norm(np.diff(both[:, : end + 1, i], axis=1)).sum(axis=1))
    return {
        "deflection": norm(both[0, 1:] - both[1, 1:]).mean(),
        "imposed_delay": lost.sum() / matched.sum(),
        "imposed_delay_positive": np.maximum(lost, 0.0).sum() / matched.sum(),
        "imposed_detour": detour.sum(),
    }


TOLERANCE = {"near_misses_per_hour": 0.05, "jerk": 1e-3, "vehicle_share": 5e-3, "post_encroachment_time": 0.0126}
TOLERANCE |= {"path_irregularity": 2e-3, "cumulative_heading_change": 2e-2, "success_heading_change": 2e-2}
TOLERANCE |= {"time_to_collision": 1.1e-3}
"""Where the grids here or the six digits of the tracks are coarse; 2e-4 otherwise."""


def compare(columns, row, found):
    for name, value in found.items():
        measured = float(columns[name][row])
        if name == "time_to_collision" and np.isinf(value):
            assert np.isnan(measured) or measured > 1.498
        elif value != UNTOLD:
            assert measured == pytest.approx(float(value), abs=TOLERANCE.get(name, 2e-4), nan_ok=True), (name, row)


@pytest.mark.parametrize("run", [*(pytest.param(run, marks=pytest.mark.slow) for run in ("seen", "stops")), "unseen"])
def test_metrics_are_those_of_the_tracks(run, request):
    columns, episodes, rewards = request.getfixturevalue(run)
    names, outcomes = set(), set()
    for row, (p, reward) in enumerate(zip(episodes, rewards, strict=True)):
        end = ends(p, reward)
        success = end["success_rate"]
        found = end | distances(p, success) | motion(p, success) | encounters(p, success)
        found |= contact(p, end["collision_rate"])
        compare(columns, row, found)
        names |= found.keys()
        outcomes.add(success)
    assert outcomes == ({True} if run == "seen" else {True, False})
    assert set(METRICS) - names - ELSEWHERE == set(costs(episodes[0], episodes[0]))


def test_costs_to_pedestrians_are_those_of_the_tracks_of_two_runs(seen, unseen):
    # Where the vehicle is not seen, the crowd walks as it does alone.
    (columns, episodes, _), (_, alone, _) = seen, unseen
    compared = [row for row, p in enumerate(episodes) if len(alone[row]) >= len(p) and columns["success_rate"][row]]
    assert len(compared) > 3
    for row in compared:
        compare(columns, row, costs(episodes[row], alone[row]))


@pytest.mark.slow
def test_distances_from_walls_are_those_of_the_tracks_and_walls(tmp_path):
    scenario = load_scenario("door_10")
    make(tmp_path / "run", "straight", scenario, "val:12")
    (tmp_path / "export").mkdir()
    export_tracks(RunResult.read(tmp_path / "run"), lambda _: scenario, tmp_path / "export", format="socnav")
    episodes = Episodes.read(tmp_path / "run" / "episodes.csv")
    for row, case in enumerate(episodes.case.tolist()):
        content = json.loads((tmp_path / "export" / "tracks" / f"val-{case}.json").read_text())
        path = [(moment["robot"]["x"], moment["robot"]["y"]) for moment in content["sequence"]]
        walls = shapely.MultiLineString(np.array(content["walls"]).reshape(-1, 2, 2).tolist())
        gap = shapely.LineString(path).distance(walls) - content["sequence"][0]["robot"]["shape"]["length"] / 2
        assert episodes.columns["clearing_distance"][row] == pytest.approx(gap, abs=1e-3)
        assert episodes.columns["wall_collision_rate"][row] == (gap < 0.0)


@pytest.mark.slow
def test_intrusions_into_groups_are_those_of_the_hulls_of_their_members():
    trace = drive("straight", "val:12", "groups_12")
    found = METRICS["group_intrusion"](trace)
    for row in range(len(trace)):
        inside = 0
        for t in range(1, trace.steps[row] + 1):
            vehicle, groups = shapely.Point(trace.position[row, t, 0]), trace.group[row, t]
            for group in np.unique(groups[groups >= 0]):
                members = trace.position[row, t, 1:][groups == group]
                apart = norm(members[:, None] - members[None]).max()
                if (
                    len(members) > 1
                    and apart <= 3.6
                    and shapely.MultiPoint(members).convex_hull.distance(vehicle) < RADIUS
                ):
                    inside += 1
                    break
        expected = inside / trace.steps[row] if trace.outcome[row] == 1 else np.nan
        assert found[row] == pytest.approx(expected, abs=1e-9, nan_ok=True)
    assert np.nanmax(found) > 0.0
