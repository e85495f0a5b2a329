"""Draws docs/foresight.gif, how a planner that looks ahead drives in a hard scenario: python docs/foresight_film.py."""

from pathlib import Path

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.figures.episode import Episode, film
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

FILM = Path(__file__).with_name("foresight.gif")

SCENARIO, CASE = "office_8", 2


def main() -> None:
    """Write the film."""
    driver = Driver(load_planner("mppi_sgan", {"filter": "kalman"})[1], "mppi_sgan")
    trace = rollout(driver, load_scenario(SCENARIO), Cases("test", CASE, CASE + 1), keep_logs=True)
    film(Episode(trace, 0), FILM)


if __name__ == "__main__":
    main()
