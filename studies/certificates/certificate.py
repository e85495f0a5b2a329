"""Certificates of cases: commands by which the vehicle succeeds, from fast planners or a search, stored as a run."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from jaxtyping import Float

from crowdbench import METRICS, Cases, Driver, InputError, Outcome, Planner, Scenario, Trace, rollout
from crowdbench.core import PERFECT_SENSOR, SPLITS
from crowdbench.runs import Parts, PlannerId, Playback, Progress, Run, RunSpec, fit_batch, is_made, make_run
from crowdbench.scenario import MAX_MARGIN, Certified, Examined
from crowdbench.utils import Executor, hold_lock, sha256, write_whole
from studies.certificates.crowds import Crowd, Known, Reacting, known_steps
from studies.certificates.search import Effort, SearchResult, Task, search
from studies.pages import keep

PLANNERS = ("orca_margin", "orca", "social_force")
"""Fast planners without torch. An episode in which one of them succeeds is a certificate."""

SEARCH = "search"
"""Origin of a certificate that is not from a planner."""

KNOWN = (Effort(cell=0.2, states=2_000), Effort(cell=0.1, states=20_000))
REACTING = (Effort(cell=0.2, states=256), Effort(cell=0.2, states=1_024))
"""Efforts in order, for crowds with known trajectories, and for crowds that are simulated for each state."""


NAME = "certificate"
"""The name of the planner in a run of certificates."""

CODE = sorted(set(Path(__file__).parent.glob("*.py")) - {Path(__file__).with_name("run.py")})
"""The files with the code that computes certificates."""

PART = 25
"""Cases of a part: an interrupt loses one part at most."""


class Certificate(NamedTuple):
    """Certificate of a case.

    Attributes:
        case: Its number.
        means: Origin of the commands, the name of a planner or `SEARCH`; empty if no commands were found.
        margin: The requested margin in metres; NaN if no commands were found.
        gap: The smallest gap to pedestrians and obstacles in metres; NaN if no commands were found.
        seconds: The time to the goal in seconds; NaN if no commands were found.
        is_exhausted: True if a search has covered its whole grid without finding commands.
        commands: The commands of all steps until the vehicle arrives; empty if none were found, and in rows of a table.
    """

    case: int
    means: str = ""
    margin: float = math.nan
    gap: float = math.nan
    seconds: float = math.nan
    is_exhausted: bool = False
    commands: Float[np.ndarray, "step 2"] = np.empty((0, 2))


def certificates(scenario: Scenario, cases: Cases, margins: Sequence[float], progress: Progress) -> list[Certificate]:
    """Find certificates.

    Args:
        scenario: The scenario of the cases.
        cases: The cases.
        margins: The margins to try, in metres, the widest first.
        progress: Called with the number of cases that are done.

    Returns:
        The certificate of each case, which does not depend on the other cases.

    Raises:
        InputError: The scenario breaks its contract.
    """
    # The vehicle's sensor need not be simulated: it does not affect pedestrians, and planners are better without noise.
    scenario = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, sensor=PERFECT_SENSOR))
    driven = [(name, rollout(name, scenario, cases, undisturbed=False)) for name in PLANNERS]
    found: dict[int, Certificate] = {}
    exhausted: set[int] = set()
    for margin in margins:
        before = len(found)
        for name, trace in driven:
            for each in _in_trace(trace, name, margin):
                found.setdefault(each.case, each)
        if len(found) > before:
            progress(len(found) - before)
        left = [case for case in cases.indices.tolist() if case not in found]
        for each in _search_cases(scenario, cases.split, left, margin, exhausted):
            found[each.case] = each
            progress(1)
    if len(found) < len(cases):
        progress(len(cases) - len(found))
    return [found.get(case, Certificate(case, is_exhausted=case in exhausted)) for case in cases.indices.tolist()]


def _in_trace(trace: Trace, means: str, margin: float) -> Iterator[Certificate]:
    """Yield the certificates among episodes by commands of `means`, with gaps of at least `margin` in metres."""
    gaps = np.fmin(np.fmin.reduce(trace.gap, axis=1), np.fmin.reduce(trace.wall_gap, axis=1))
    for row in np.flatnonzero((trace.outcome == Outcome.SUCCESS) & (gaps >= margin)).tolist():
        commands = trace.command[row, : trace.steps[row]]
        seconds = trace.rules.dt * len(commands)
        yield Certificate(int(trace.case[row]), means, margin, float(gaps[row]), seconds, commands=commands)


def _search_cases(
    scenario: Scenario, split: str, cases: list[int], margin: float, exhausted: set[int]
) -> Iterator[Certificate]:
    """Search for commands in cases that no planner has solved, and yield those by which the vehicle succeeds.

    The cases in which a search has covered the whole grid are added to `exhausted`.
    """
    if not cases:
        return
    is_visible = scenario.rules.visible
    # Pedestrians depend on the vehicle's motion if they see it, or if they are placed away from it.
    is_placed = scenario.crowd.arrival in ("new_goal", "respawn") or scenario.crowd.goal_change is not None
    depends_on_vehicle = is_visible or is_placed or scenario.tracks is not None
    world = scenario.draw(split, np.array(cases))
    tasks = [Task.of(world, row, margin) for row in range(len(cases))]
    certified: set[int] = set()

    def replay(rows: Sequence[int], results: Iterable[SearchResult]) -> Iterator[Certificate]:
        """Simulate the found commands of some rows, and yield certificates for rows in which the vehicle succeeds."""
        for row, result in zip(rows, results, strict=True):
            certificate = None
            if result.commands is not None:
                alone = Cases(split, cases[row], cases[row] + 1)
                trace = rollout(play_back([result.commands], scenario), scenario, alone, undisturbed=False)
                certificate = next(_in_trace(trace, SEARCH, margin), None)
            if certificate is not None:
                certified.add(row)
                yield certificate
            elif result.is_exhaustive and not depends_on_vehicle:
                exhausted.add(cases[row])

    if not is_visible:
        steps = known_steps(scenario, world)

        def search_known(row: int) -> SearchResult:
            return _search_harder(tasks[row], Known([step.row(row) for step in steps]), margin, KNOWN)

        # Threads, because the compiled search releases Python's lock.
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            yield from replay(range(len(cases)), pool.map(search_known, range(len(cases))))
    if depends_on_vehicle:
        left = [row for row in range(len(cases)) if row not in certified]

        def search_reacting(row: int) -> SearchResult:
            crowd = Reacting(scenario, world.take(np.array([row])))
            return _search_harder(tasks[row], crowd, margin, REACTING)

        yield from replay(left, map(search_reacting, left))


def play_back(commands: Sequence[Float[np.ndarray, "step 2"]], scenario: Scenario) -> Planner:
    """Return a planner that replays the commands of each case until they end."""
    padded = np.zeros((len(commands), scenario.rules.max_steps, 2))
    for row, of_case in zip(padded, commands, strict=True):
        row[: len(of_case)] = of_case
    return Playback(padded, privileged=True)


def _search_harder(task: Task, crowd: Crowd, margin: float, efforts: Sequence[Effort]) -> SearchResult:
    """Search with one effort after the other until commands are found; the margin is in metres."""
    for effort in efforts:
        result = search(task, crowd, margin, effort)
        if result.commands is not None:
            break
    return result


def make(
    scenario: Scenario,
    cases: Cases,
    margin: float,
    out: Path,
    *,
    overrides: Mapping[str, Any],
    overwrite: bool = False,
    executor: Executor | None = None,
    progress: Progress,
) -> list[Certificate]:
    """Create the missing certificates of cases.

    In `out` they are a run, in a directory named after the split. Beside it, `SPLIT.json` has the origin of each one,
    and `NAME.toml` lists the cases without certificate, if the cases begin with the first one of the split.

    Args:
        scenario: The scenario.
        cases: The cases.
        margin: The wider of the margins that are tried, in metres; the other one is 0.
        out: The directory to write.
        overrides: Changes of the scenario, for `result.json`.
        overwrite: True if earlier certificates of this split are replaced.
        executor: Workers that create them, if any.
        progress: Called with the number of cases that are done.

    Returns:
        The certificate of each case.

    Raises:
        InputError: The margin is out of range, the scenario breaks its contract, or the directory cannot be written.
        KeyboardInterrupt: Interrupted. Finished parts are kept.
    """
    if not 0.0 <= margin < MAX_MARGIN:
        raise InputError(f"a margin of {margin:g} m is not possible: give 0 m or more, and less than {MAX_MARGIN:g} m")
    search = CertificateSearch(scenario, cases, list(dict.fromkeys([margin, 0.0])), out, overrides)
    if executor is not None and not is_made(search.run, search.directory, overwrite):
        _make_with(executor, search, progress)
        progress = _ignore
    drive = functools.partial(search.drive, progress)
    make_run(search.run, search.directory, drive=drive, overwrite=overwrite, progress=progress)
    rows = _read([search.table])
    if cases.start == 0:
        _list_without(scenario, cases.split, margin, rows, out / f"{scenario.name}.toml")
    return rows


@dataclasses.dataclass(frozen=True)
class CertificateSearch:
    """The certificates of cases as a run, which is made in parts, in any process.

    Attributes:
        scenario: The scenario.
        cases: The cases.
        margins: The margins to try, in metres, the widest first.
        out: The folder of the certificates.
        overrides: Changes of the scenario, for `result.json`.
    """

    scenario: Scenario
    cases: Cases
    margins: Sequence[float]
    out: Path
    overrides: Mapping[str, Any]

    @property
    def directory(self) -> Path:
        """The directory of the run."""
        return self.out / self.cases.split

    @property
    def table(self) -> Path:
        """The file with the origin of each certificate."""
        return self.out / f"{self.cases.split}.json"

    @property
    def run(self) -> Run:
        """The run, with a planner that each part replaces by its own commands."""
        batch = fit_batch(PART, self.scenario)
        spec = RunSpec(NAME, self.scenario.name, self.cases, overrides=self.overrides, batch=batch)
        sources = {path.name: sha256(path) for path in CODE}
        identity = PlannerId(NAME, files={"study": sources}, key=f"margins {self.margins}")
        return Run(spec, Driver(play_back([], self.scenario), NAME), self.scenario, METRICS, identity)

    def drive(self, progress: Progress, part: Cases, folder: Path) -> None:
        """Create the certificates of a part in a folder, and add them to the table."""
        parts = Parts.of(self.run, self.directory).folder
        found = certificates(self.scenario, part, self.margins, progress)
        _write(found, parts / f"found-{part.start}.json")
        with hold_lock(parts / ".table"):
            _write(_read(sorted(parts.glob("found-*.json"))), self.table)
        player = Driver(play_back([each.commands for each in found], self.scenario), NAME)
        dataclasses.replace(self.run, driver=player).drive(part, folder)


def _make_with(executor: Executor, search: CertificateSearch, progress: Progress) -> None:
    """Create the missing parts with workers."""
    search = dataclasses.replace(search, out=search.out.absolute())  # workers may start in another folder
    parts = Parts.of(search.run, search.directory)
    with parts.open():
        missing = parts.missing(search.cases)
        progress(len(search.cases) - sum(map(len, missing)))
        batches = itertools.chain(*(gap.batches(search.run.spec.batch) for gap in missing))
        futures = {executor.submit(_make_part, search, part): part for part in batches}
        for future in as_completed(futures):
            future.result()
            progress(len(futures[future]))


def _make_part(search: CertificateSearch, part: Cases) -> None:
    Parts.of(search.run, search.directory).make(part, functools.partial(search.drive, _ignore))


def _ignore(done: float) -> None:
    """Report no progress: the process that hands out the parts does."""


def _write(found: Sequence[Certificate], path: Path) -> None:
    """Write the certificates of some cases, without the commands."""
    keep([{name: getattr(each, name) for name in Certificate._fields[:-1]} for each in found], path)


def _read(paths: Sequence[Path]) -> list[Certificate]:
    """Return the certificates in some files, in the order of cases."""
    found = []
    for row in (row for path in paths for row in json.loads(path.read_text(encoding="utf-8"))):
        fields: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
        found.append(Certificate(**fields))
    return sorted(found, key=lambda each: each.case)


def _list_without(scenario: Scenario, split: str, margin: float, found: Sequence[Certificate], path: Path) -> None:
    """Write the cases of a split without certificate to a file, and keep its entries for other splits.

    Args:
        scenario: The scenario.
        split: The split.
        margin: The wider margin in metres.
        found: The certificate of each case, from the first one.
        path: The file; it is replaced if it is for another digest or another margin.
    """
    before = Certified.read(path)
    is_same = before is not None and (before.scenario, before.margin) == (scenario.digest, margin)
    splits = {name: getattr(before, name) for name in SPLITS if is_same and getattr(before, name)}
    uncertified = [each.case for each in found if not each.means]
    narrow = [each.case for each in found if each.margin < margin]
    splits[split] = Examined(examined=len(found), uncertified=uncertified, narrow=narrow)
    with write_whole(path) as partial:
        lines = [f'scenario = "{scenario.digest}"', f"margin = {float(margin)!r}"]
        for name in filter(splits.get, SPLITS):
            lines += ["", f"[{name}]", *(f"{key} = {value}" for key, value in splits[name])]
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")
