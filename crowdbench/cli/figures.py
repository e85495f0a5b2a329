"""The commands that make figures and films."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from crowdbench.cli.console import announce_compilation, say
from crowdbench.utils.errors import InputError


def plot(
    kind: Literal["success", "metric", "training"],
    directories: list[Path],
    metric: str | None = None,
    out: Path = Path("figure.pdf"),
) -> None:
    """Draw a figure of runs, or of trainings, as wide as a column of a paper.

    Args:
        kind: success: cases solved over time. metric: the distribution of --metric. training: --metric over training,
            a column of curve.csv such as reward; by default success.
        directories: Directories of runs; for training, of trainings.
        metric: The metric of a figure of kind metric.
        out: The figure: a .pdf, .svg or .png file.
    """
    from crowdbench.figures import plots

    if kind == "metric" and metric is None:
        raise InputError("a figure of kind metric needs --metric NAME")
    if kind == "success" and metric is not None:
        raise InputError(f"a figure of kind {kind} takes no --metric: only metric and training do")
    if kind == "success":
        plots.success_over_time(directories, out)
    elif kind == "metric":
        plots.distribution(directories, str(metric), out)
    else:
        plots.learning_curves(directories, out, metric or "success")
    say(f"wrote {out}")


def render(
    what: list[str],
    case: str | None = None,
    worst: str | None = None,
    strip: Annotated[int | None, typer.Option(min=1, max=12)] = None,
    zoom: Annotated[float | None, typer.Option(min=1.0, max=100.0)] = None,
    out: Path = Path("case.png"),
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
) -> None:
    """Draw a case of a run from above, as a figure or a film, or the start of a case of a scenario.

    Several runs are drawn side by side in the same case, which is simulated again from its commands. Predicted and
    planned paths are drawn in recorded cases. No viewer is needed.

    Args:
        what: Directories of runs, or one scenario: a name, or ./mine.toml.
        case: The case: val/37, or its number; else the first failure of a run, or the first test case of a scenario.
        worst: The case of the (first) run in which this metric, such as minimum_gap, is worst.
        strip: Number of moments of one run that are drawn side by side, instead of the whole path.
        zoom: Number of metres around the vehicle that are shown; a film and moments follow the vehicle.
        out: A figure (.pdf, .svg or .png) or a film (.gif, .webp, or .mp4 with ffmpeg).
        pedestrians: Your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: Your file of a layout that the run used, ./mine.py.
    """
    from crowdbench.cli.cases import choose_case, make_loader
    from crowdbench.figures import episode_figure as episode
    from crowdbench.scenario.cases import parse_case

    if strip is not None and (out.suffix in episode.FILMS or len(what) > 1):
        raise InputError(
            "--strip draws a figure of one run: leave it out, or give one run and a .pdf, .svg or .png file"
        )
    if all(Path(each).is_dir() for each in what):
        from crowdbench.results.run_result import RunResult

        runs = [RunResult.read(Path(each), tables_only=True) for each in what]
        number = choose_case(runs, case, worst)
        announce_compilation()
        episodes = episode.stored_episodes(runs, number, make_loader(pedestrians, layout, data), zoom)
        episode.draw_episodes(episodes, out, strip)
    else:
        if len(what) > 1:
            raise InputError(f"{' '.join(what)} are not all runs: give directories of runs, or one scenario")
        for name, given in (("strip", strip), ("zoom", zoom), ("worst", worst)):
            if given is not None:
                raise InputError(f"--{name} is for a case of a run: a scenario has its start alone")
        from crowdbench.catalog import load_scenario

        scenario = load_scenario(what[0], data=data)
        scenario.check_data(data)
        episode.draw_start(scenario, *parse_case(case or "0", "test"), out)
    say(f"wrote {out}")
