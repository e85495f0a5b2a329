"""The study of networks that were trained with several vehicles in a world."""

import re
from pathlib import Path

import numpy as np
import pytest

from crowdbench import load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from studies.fleets import run as study

FOLDER = Path(study.__file__).parent
PAGE = (FOLDER / "README.md").read_text()


def scores(section):
    """The mean of each row in `fleet_4`."""
    rows = PAGE.split(f"## {section}")[1].split("\n\n")[1].splitlines()[2:]
    return {row.split("|")[1].strip(): float(re.search(r"\d+\.\d+", row.split("|")[2])[0]) for row in rows}


def test_each_network_that_learned_with_other_vehicles_scores_more_than_orca():
    score = scores("Score")
    assert set(score) == {*study.NETWORKS, *study.PLANNERS}
    assert min(score[name] for name in study.NETWORKS) > score["orca"]


@pytest.mark.slow
@pytest.mark.parametrize("file", ["ippo", "mappo"])
def test_a_file_of_the_study_drives_four_vehicles(file):
    planner = load_planner(str(FOLDER / f"{file}.py"))
    trace = rollout(Driver(planner, file), load_scenario("fleet_4"), Cases("val", 0, 6), undisturbed=False)
    assert np.mean(trace.outcome == Outcome.SUCCESS) > 0.8
