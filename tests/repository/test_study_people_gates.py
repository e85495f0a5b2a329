"""The table of pedestrian models, and the film beside it."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from repository.test_study_people import crossings

from crowdbench.utils.errors import InputError
from studies import people
from studies.people import film, gates
from studies.people.summary import Figure

PAGE = (Path(people.__file__).parent / "models.md").read_text("utf-8")


def row(**changes):
    even = Figure(1.0, 0.9, 1.1)
    figures = dict.fromkeys(("v3", "minus_orca", "minus_blind", "hidden", "ratio"), even)
    numbers = {"speed": 0.9, "acceleration": 1.0, "reversals": 0.1, "overlap": 0.0}
    return gates.Row(**{"model": "mine", **figures, **numbers, **changes})


@pytest.mark.parametrize(
    ("changes", "failed"),
    [
        ({}, []),
        ({"ratio": Figure(0.6, 0.49, 0.7)}, ["contacts"]),
        ({"ratio": Figure(1.9, 1.8, 2.1)}, ["contacts"]),
        ({"ratio": Figure(1.0, 0.5, 2.0), "speed": 0.8}, []),
        ({"speed": 0.79}, ["speed"]),
        ({"acceleration": 1.87}, ["motion"]),
        ({"reversals": 0.24}, ["motion"]),
        ({"overlap": 0.0124, "speed": 0.1}, ["speed", "motion"]),
    ],
)
def test_a_row_names_the_gates_that_it_fails(changes, failed):
    made = row(**changes)
    assert made.failed == made.record["failed"] == failed
    assert made.cells[1] == (f"fails {', '.join(failed)}" if failed else "passes")


def test_the_page_has_the_columns_and_the_bounds_of_the_code():
    header = [cell.strip() for cell in re.search(r"\| model \| gates.*", PAGE)[0].strip("|").split("|")]
    assert header == gates.HEADER.split("|")
    assert len(row().cells) == len(header)
    bounds = f"{gates.MOST_ACCELERATION} m/s², {gates.MOST_REVERSALS}, {gates.MOST_OVERLAP:.2%}".replace("%", " %")
    assert bounds in PAGE
    assert f"at least {gates.SPEED}" in PAGE
    assert gates.RATIO == (0.5, 2.0)
    assert gates.SCENARIO in PAGE


def test_the_bounds_of_motion_are_the_largest_figures_of_the_folds():
    page = (Path(people.__file__).parents[1] / "validity" / "motion.md").read_text("utf-8")
    rows = [line.strip("|").split("|") for line in page.splitlines()]
    names = ("biwi_hotel", "crowds_zara01", "crowds_zara02", "crowds_zara03", "students003")
    figures = [[cells[3], cells[5], cells[7].replace("%", "")] for cells in rows if cells[0].strip() in names]
    largest = np.array(figures, float).max(axis=0)
    assert largest.tolist() == [
        gates.MOST_ACCELERATION,
        gates.MOST_REVERSALS,
        pytest.approx(100 * gates.MOST_OVERLAP),
    ]


def test_the_answer_is_the_order_of_the_film():
    answer = re.findall(r"^\| ([A-D]) \| (.*) \|$", PAGE, re.MULTILINE)
    order = film.shuffled([film.RECORDING, "orca", "orca_people", "learned_people"])
    names = [name if name == film.RECORDING else f"`{name}`" for name in order]
    assert answer == list(zip("ABCD", names, strict=True))


@pytest.mark.slow
def test_the_film_shows_all_panels_in_all_frames():
    paths = [crossings(windows=1)[0].future[:2]] * 3
    pictures = list(film.draw(paths))
    assert len(pictures) == round(0.4 * film.RATE) + 1
    first = np.asarray(pictures[0])
    middle = first.shape[0] // 2
    assert first[4, first.shape[1] // 4, 3] == 255  # the first panel
    assert (first[middle + 20 :, first.shape[1] // 2 + 20 :, 3] == 0).all()  # there is no fourth panel
    assert Image.Image is type(pictures[0])


def test_people_are_on_smooth_curves_through_the_recorded_positions():
    path = np.full((21, 2, 2), np.nan)
    path[:, 0, 0], path[:, 0, 1] = np.linspace(0.0, 8.0, 21), 1.0
    path[4:9, 1] = np.random.default_rng(0).normal(size=(5, 2))
    smooth = film.smoothed(path)
    assert len(smooth) == 8 * film.RATE + 1
    assert smooth[:, 0, 0] == pytest.approx(np.linspace(0.0, 8.0, len(smooth)))
    here = np.isfinite(smooth[:, 1, 0])
    assert here.tolist() == [1.6 - 1e-9 <= frame / film.RATE <= 3.2 + 1e-9 for frame in range(len(smooth))]
    assert smooth[round(2.0 * film.RATE), 1] == pytest.approx(path[5, 1])


@pytest.mark.parametrize(
    ("name", "number", "message"),
    [("nowhere", 0, "--recording is 'nowhere', but must be one of biwi_hotel, ")],
)
def test_an_unknown_window_gets_one_sentence(name, number, message, tmp_path):
    with pytest.raises(InputError, match=message):
        film.find_window(tmp_path, name, number)
