"""Runs from Python: `crowdbench.run` drives a planner through cases and returns a result that a notebook can show."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.metrics.registry import METRICS, Metric
from crowdbench.metrics.summary import Estimate
from crowdbench.metrics.user_metrics import RESERVED
from crowdbench.planners.planner import Planner
from crowdbench.results.compare import Comparison, compare
from crowdbench.results.episodes import Episodes, read_estimate
from crowdbench.results.run_result import RunResult
from crowdbench.results.table import metric_grid
from crowdbench.runs.identity import new_key
from crowdbench.runs.loading import load_run, load_stored_scenario
from crowdbench.runs.make import make_run
from crowdbench.runs.replay import recording_of, stored_case
from crowdbench.runs.rollout import Progress
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.defaults import RECORD
from crowdbench.utils.errors import InputError, require
from crowdbench.utils.progress_bars import announce_compilation
from crowdbench.utils.progress_bars import progress as show_progress
from crowdbench.utils.tables import markdown

if TYPE_CHECKING:
    from PIL.Image import Image


@dataclass(frozen=True, repr=False)
class Result:
    """Results of a run. A notebook shows a table of all metrics.

    Attributes:
        planner: The planner's name with its options.
        scenario: The scenario's name.
        cases: The cases.
        metrics: The mean of each metric with its 95 % interval, by name; rates are shares.
        episodes: A row per case: `episodes.to_arrow()`, `pandas.DataFrame.from_arrow(episodes)`, and
            `polars.DataFrame(episodes)` are tables of it.
        directory: The directory of the run; None if the run is not kept.
    """

    planner: str
    scenario: str
    cases: str
    metrics: Mapping[str, Estimate]
    episodes: Episodes
    directory: Path | None

    @classmethod
    def read(cls, directory: Path | str) -> Result:
        """Read the result of `crowdbench run` or `run` from its directory.

        Raises:
            InputError: A file is missing, or was changed after the run.
        """
        run = RunResult.read(Path(directory))
        metrics = {name: read_estimate(estimate) for name, estimate in run.result["metrics"].items()}
        scenario, cases = run.result["scenario"]["name"], run.result["run"]["cases"]
        return cls(run.label, scenario, cases, metrics, run.episodes, run.directory)

    @property
    def failures(self) -> dict[str, list[int]]:
        """The cases that failed, by outcome."""
        return self.episodes.failures

    def compare(self, other: Result) -> Comparison:
        """Compare with another run of the same scenario, case by case; a notebook shows it as a table.

        Raises InputError if one of the runs was not kept, or if they share no case.
        """
        return compare(self._stored_directory(), other._stored_directory())

    def view(self, case: int | str, *, web: bool = False, **files: Any) -> None:
        """Open a case in the Rerun viewer, and wait until it is closed.

        Args:
            case: The number of the case, or its name: "val/37".
            web: True to open it in a browser instead of a window.
            **files: Files of yours that the run used, the parameters of `load_stored_scenario`: pedestrians, layout and
                data. They are needed if the case was not recorded.

        Raises:
            InputError: The run was not kept or has no commands, there is no such case, or the viewer does not start.
        """
        from crowdbench.record import viewer

        run = RunResult.read(self._stored_directory())
        number = run.find_case(case)
        with tempfile.TemporaryDirectory() as folder:
            recording = recording_of(run, functools.partial(load_stored_scenario, **files), number, Path(folder))
            viewer.view(recording, number, web=web)

    def render(self, case: int | str, **files: Any) -> Image:
        """Draw a case from above, as an image for a notebook or for its method `save("case.png")`.

        Args:
            case: The number of the case, or its name: "val/37".
            **files: See `view`.

        Raises:
            InputError: The run was not kept or has no commands, or there is no such case.
        """
        from crowdbench.envs.render import rasterize
        from crowdbench.figures.episode_figure import Episode

        run = RunResult.read(self._stored_directory())
        trace, row = stored_case(run, functools.partial(load_stored_scenario, **files), run.find_case(case))
        return rasterize(*Episode(trace, row).picture(), 300.0)

    def _stored_directory(self) -> Path:
        if self.directory is None:
            raise InputError("the run was not kept: give run(..., out=DIR)")
        return self.directory

    def __repr__(self) -> str:
        title = f"**{self.planner}** on {self.scenario}, cases {self.cases}"
        grid = metric_grid(title, self.metrics, self.episodes.rates)
        return f"{title}\n\n{markdown(grid.header, grid.rows)}"

    def _repr_markdown_(self) -> str:
        """Return the Markdown that Jupyter shows."""
        return repr(self)


def run(
    planner: str | Planner,
    scenario: str = "circle_crossing_5",
    cases: int | str = 500,
    *,
    options: Mapping[str, Any] | None = None,
    overrides: Mapping[str, Any] | None = None,
    pedestrians: str | None = None,
    metrics: Mapping[str, Metric] | None = None,
    data: Path | str | None = None,
    out: Path | str | None = None,
    key: str | None = None,
    record: str = RECORD[0],
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Drive a planner through the cases of a scenario and score it, as `crowdbench run` does.

    Args:
        planner: Name or file of a planner, or a planner object.
        scenario: The scenario's name or file.
        cases: Number of test cases, or cases in the format of `crowdbench run --cases`, such as "val:100".
        options: Options of a planner that is given by its name or file.
        overrides: Other values for keys of the scenario, by dotted key.
        pedestrians: The name or the file of a policy that moves all pedestrians.
        metrics: Metrics of your own by name: functions of a trace, measured after the built-in ones.
        data: The folder with recorded tracks, if the scenario needs them.
        out: The directory for the results; None to keep nothing.
        key: Your name for this version of a planner or of metrics that are defined in Python. An interrupted run can
            be continued only with a key: without it, crowdbench cannot detect whether they have changed.
        record: Extent of the recording of a run that is kept, one of `defaults.RECORD`.
        overwrite: True to replace an earlier run in `out`.
        progress: Called after each step with the progress of the step, as a fractional number of episodes, such as
            `tqdm(total=500, unit_scale=True).update`; None to show a line of progress every few seconds.

    Raises:
        InputError: An input does not exist, a plug-in breaks its contract, or the run cannot be written.
    """
    require("planner", planner, isinstance(planner, str | Planner), "a name, a file or a Planner, such as MyPlanner()")
    if options and not isinstance(planner, str):
        raise InputError("options are for a planner that is named: give them to the planner that you construct")
    if key is not None and isinstance(planner, str) and not metrics:
        raise InputError("key is for what was made in Python: a planner or metrics; leave it out")
    for name in metrics or {}:
        if name in METRICS or name in RESERVED:
            raise InputError(f"a column {name} exists already: give the metric another name")
    spec = RunSpec(
        planner if isinstance(planner, str) else type(planner).__name__,
        scenario,
        Cases.parse(str(cases)),
        options=options or {},
        overrides=overrides or {},
        pedestrians=pedestrians,
        record="none" if out is None else record,
        data=None if data is None else Path(data).absolute(),
    )
    announce_compilation()
    loaded = load_run(spec, None if isinstance(planner, str) else planner, key=key)
    if metrics:
        identity = dataclasses.replace(loaded.planner, key=loaded.planner.key or key or new_key())
        loaded = dataclasses.replace(loaded, metrics={**loaded.metrics, **metrics}, planner=identity)
    loaded.scenario.check_data(spec.data)
    shown = contextlib.nullcontext(progress) if progress else show_progress(len(spec.cases))
    with tempfile.TemporaryDirectory() as folder, shown as report:
        if out is not None:
            if not make_run(loaded, Path(out), overwrite=overwrite, progress=report):
                raise InputError(f"another process is making the run {out}: try again when it has ended")
            return Result.read(out)
        make_run(loaded, Path(folder) / "run", progress=report)
        return dataclasses.replace(Result.read(Path(folder) / "run"), directory=None)
