"""The best known commands of validation cases: their file, and the replay that every entry must pass."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from crowdbench import METRICS, Cases, InputError, Outcome, Scenario, rollout
from crowdbench.runs import Playback
from crowdbench.sim import SIMULATOR
from crowdbench.utils import check_record, read_json, write_whole
from studies.best_times.beam import QUANTUM, as_stored

FOLDER = Path(__file__).with_name("found")
FORMAT = 1

BETTER = 1e-6
"""Smallest gain of a score by which commands replace others."""


class Entry(BaseModel):
    """The best known commands of a validation case.

    Attributes:
        case: The number of the case.
        score: Their score in the replay; 0 if none are known.
        time: Time to the goal in seconds.
        close: Seconds close to pedestrians.
        holder: The search, or the label of a planner, that found them; empty if none are known.
        date: The day on which they were found.
        commands: In multiples of `QUANTUM`, as 16-bit integers in base64.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    case: int
    score: float = 0.0
    time: float = 0.0
    close: float = 0.0
    holder: str = ""
    date: str
    commands: str = ""

    def decoded(self) -> Float[np.ndarray, "step 2"]:
        """Return the commands in the units of the dynamics. Raises InputError if they are damaged."""
        try:
            stored = np.frombuffer(base64.b64decode(self.commands, validate=True), "<i2")
            return stored.reshape(-1, 2) * QUANTUM
        except ValueError:
            raise InputError(f"the commands of case val/{self.case} are damaged: search them again") from None


class BestTimes(BaseModel):
    """The file of a scenario.

    Attributes:
        format: The version of the format.
        scenario: The name of the scenario.
        digest: The digest of the scenario.
        simulator: The version of the simulator.
        entries: The searched cases, by number.
    """

    model_config = ConfigDict(extra="forbid")

    format: int = FORMAT
    scenario: str
    digest: str
    simulator: int = SIMULATOR
    entries: list[Entry] = []

    @classmethod
    def read(cls, scenario: Scenario, folder: Path = FOLDER) -> BestTimes:
        """Read the file of a scenario; without a file, there are no entries.

        Raises:
            InputError: The file is damaged, or for another scenario or simulator.
        """
        path = folder / f"{scenario.name}.json"
        new = cls(scenario=scenario.name, digest=scenario.digest)
        if not path.exists():
            return new
        best = check_record(cls, read_json(path), path, "file of best times", FORMAT)
        if (best.digest, best.simulator) != (new.digest, new.simulator):
            raise InputError(f"{path} is for another {scenario.name} or simulator: remove it, and search again")
        return best

    def write(self, folder: Path = FOLDER) -> None:
        """Write the file."""
        with write_whole(folder / f"{self.scenario}.json") as partial:
            rows = ",\n".join(json.dumps(each.model_dump()) for each in self.entries)
            head = json.dumps(self.model_dump(exclude={"entries"}))
            partial.write_text(f'{head[:-1]}, "entries": [\n{rows}\n]}}\n', encoding="utf-8")

    def of(self, case: int) -> Entry | None:
        """Return the entry of a case; None if it was not searched."""
        return next((each for each in self.entries if each.case == case), None)

    def put(self, entry: Entry) -> bool:
        """Add an entry unless the case has one that is as good; return whether it was added."""
        before = self.of(entry.case)
        if before is not None and entry.score <= before.score + BETTER:
            return False
        others = [each for each in self.entries if each.case != entry.case]
        self.entries = sorted([*others, entry], key=lambda each: each.case)
        return True


def replay(scenario: Scenario, case: int, commands: Float[np.ndarray, "step 2"], holder: str, date: str) -> Entry:
    """Replay commands in a validation case, as they are stored, and return their entry.

    Raises:
        InputError: The vehicle does not succeed.
    """
    stored = as_stored(commands)
    padded = np.zeros((1, scenario.rules.max_steps, 2))
    padded[0, : len(stored)] = stored * QUANTUM
    trace = rollout(Playback(padded, privileged=True), scenario, Cases("val", case, case + 1), undisturbed=False)
    outcome = Outcome(int(trace.outcome[0]))
    if outcome is not Outcome.SUCCESS:
        ending = outcome.name.lower().replace("_", " ")
        raise InputError(f"the commands by {holder} for {scenario.name}, case val/{case}, end with a {ending}")
    score, time, close = (float(METRICS[name](trace)[0]) for name in ("score", "navigation_time", "t_close"))
    text = base64.b64encode(stored[: int(trace.steps[0])].astype("<i2").tobytes()).decode()
    return Entry(case=case, score=score, time=time, close=close, holder=holder, date=date, commands=text)


def check_replays(scenario: Scenario, best: BestTimes) -> None:
    """Raise InputError unless the commands of all entries have their scores when they are replayed."""
    for entry in best.entries:
        if entry.commands:
            score = replay(scenario, entry.case, entry.decoded(), entry.holder, entry.date).score
            if abs(score - entry.score) > BETTER:
                case = f"{scenario.name}, case val/{entry.case}"
                raise InputError(
                    f"{case} has the score {score:.6f} when it is replayed, but {entry.score:.6f} is stored"
                )


def replace_by_planner(
    scenario: Scenario,
    best: BestTimes,
    case: int,
    score: float,
    commands: Float[np.ndarray, "step 2"],
    holder: str,
    date: str,
) -> bool:
    """Replace the entry of a case by the commands of a planner if they are better, also after their rounding.

    Args:
        scenario: The scenario.
        best: Its entries.
        case: The number of the case.
        score: The score of the planner.
        commands: Its commands.
        holder: Its label.
        date: The day.

    Returns:
        True if they replace the entry.
    """
    before = best.of(case)
    if before is None or score <= before.score + BETTER:
        return False
    try:
        return best.put(replay(scenario, case, commands, holder, date))
    except InputError:  # rounding has changed the outcome
        return False
