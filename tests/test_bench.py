"""The measurements run and are told apart; how fast anything is, no test judges."""

import io

import numpy as np
import pytest
from rich.console import Console

from crowdbench.bench import Row, measure
from crowdbench.tables import bench_table


def test_every_measurement_gives_a_time(monkeypatch):
    monkeypatch.setattr(measure, "ROUNDS", 1)
    monkeypatch.setattr(measure.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(measure, "_commands", lambda: iter([Row("start-up", 0.1, "s")]))
    rows = list(measure.rows())
    assert len(rows) == 6
    assert all(row.ours > 0 for row in rows)
    assert all(row.theirs is None for row in rows)


def test_a_command_is_timed_with_its_memory():
    seconds, memory = measure._command(["--help"])
    assert 0.0 < seconds < 60.0
    assert 1e7 < memory < 1e11


def test_all_measured_agents_are_at_work_in_every_step():
    for agents in (6, 51):
        start = measure.circle(agents, 1)
        apart = np.linalg.norm(start[0, :, None] - start[0], axis=-1) + np.eye(agents) * 9
        assert apart.min() > 2 * measure.RADIUS
        assert 2 * np.linalg.norm(start, axis=-1).min() > measure.STEPS * measure.DT


def test_the_table_says_how_many_times_quicker():
    out = io.StringIO()
    Console(file=out, width=200).print(bench_table([Row("walking", 2.0, "us", 5.0), Row("alone", 1.0, "s")]))
    assert "2.5x" in out.getvalue()
    assert Row("alone", 1.0, "s").ratio is None
    assert Row("walking", 2.0, "us", 5.0).ratio == pytest.approx(2.5)
