"""The result of a run: tables, trajectories, pictures and comparisons, for notebooks and scripts."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.core.types import Trace
from crowdbench.metrics.summary import Estimate
from crowdbench.results.compare import Comparison, compare_results
from crowdbench.results.episodes import Episodes, read_estimate
from crowdbench.results.result_file import digest_of, read_result
from crowdbench.results.run_result import RunResult
from crowdbench.results.table import metric_grid
from crowdbench.runs.identity import without_random_key
from crowdbench.runs.loading import load_stored_scenario
from crowdbench.runs.replay import Loader, recording_of, stored_case
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, require
from crowdbench.utils.tables import markdown

if TYPE_CHECKING:
    from PIL.Image import Image


class TemporaryFolder:
    """Folder that is removed with the last object that refers to it, or when Python exits.

    Attributes:
        path: The folder.
    """

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="crowdbench-"))
        self._removal = weakref.finalize(self, _remove, self.path, os.getpid())

    def keep_if_filled(self) -> None:
        """Keep the folder if something is in it, such as the finished parts of a run that has failed."""
        if any(self.path.iterdir()):
            self._removal.detach()

    def __deepcopy__(self, memo: object) -> TemporaryFolder:
        return self

    def __reduce__(self) -> Any:
        raise InputError("a result in a temporary folder cannot be pickled: keep it with result.save(DIR)")


def _remove(folder: Path, process: int) -> None:
    """Remove a folder, but not in a child process of the process that made it."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """Results of a run. A notebook shows a table of all metrics.

    `trace`, `view` and `render` simulate a case again from the stored commands, without the planner. Files of yours
    that a run used are arguments of these methods, if the result was read from a directory: `pedestrians`, `layout` and
    `data`, the parameters of `load_stored_scenario`.

    Attributes:
        id: The identity of the run, with 64 hexadecimal digits.
        planner: The planner's name with its options.
        scenario: The scenario's name.
        cases: The cases.
        metrics: The mean of each metric with its 95 % interval, by name; rates are shares.
        episodes: A row per case: `episodes.to_pandas()`, `episodes.to_arrow()` and `polars.DataFrame(episodes)` are
            tables of it.
        directory: The directory of the run; a temporary one of a run without `out`, which is removed with the result.
    """

    id: str
    planner: str
    scenario: str
    cases: str
    metrics: Mapping[str, Estimate]
    episodes: Episodes
    directory: Path
    _loaded: Scenario | None = None
    _temporary: TemporaryFolder | None = None

    @classmethod
    def read(cls, directory: Path | str) -> Result:
        """Read the result of `crowdbench run` or `run` from its directory.

        Raises:
            InputError: A file is missing, or was changed after the run.
        """
        run = RunResult.read(as_path("directory", directory))
        metrics = {name: read_estimate(estimate) for name, estimate in run.result["metrics"].items()}
        scenario, cases = run.result["scenario"]["name"], run.result["run"]["cases"]
        return cls(run.result["id"], run.label, scenario, cases, metrics, run.episodes, run.directory)

    @property
    def failures(self) -> dict[str, list[int]]:
        """The cases that failed, by outcome."""
        return self.episodes.failures

    def save(self, directory: Path | str, *, overwrite: bool = False) -> Result:
        """Copy the run to a directory, which `Result.read` and the commands of crowdbench read.

        Args:
            directory: The directory. If it contains this run already, nothing is written; a run that differs only in
                the random key of a planner object is replaced.
            overwrite: True to replace an earlier run in it.

        Returns:
            The result in the new directory.

        Raises:
            InputError: The directory exists, or cannot be written.
        """
        path = as_path("directory", directory)
        earlier = find_earlier(path, self._stored().result["run"])
        if earlier != self.id:
            with files.new_directory(path, overwrite or bool(earlier)) as folder:
                shutil.copytree(self.directory, folder, dirs_exist_ok=True)
        return replace(self, directory=path, _temporary=None)

    def compare(self, other: Result) -> Comparison:
        """Compare with another run of the same scenario, case by case; a notebook shows it as a table.

        Raises:
            InputError: The runs have different scenarios, or share no case.
        """
        require("other", other, isinstance(other, Result), "the result of another run")
        names = (self.planner, other.planner)
        if self.planner == other.planner and (self._temporary or other._temporary):
            names = (f"{self.planner}, first run", f"{other.planner}, second run")
        return compare_results(self._stored(), other._stored(), names=names)

    def trace(self, case: int | str, **files: Any) -> Trace:
        """Return one episode as a trace of one world.

        `trace.position[0]` is `[time, agent, 2]` in metres: agent 0 is the vehicle, and state 0 is the start. See
        `Trace` for the other arrays. `matplotlib.pyplot.plot(*trace.position[0, :, 0].T)` plots the vehicle's path.

        Args:
            case: The number of the case, or its name: "val/37".
            **files: See `Result`.

        Raises:
            InputError: The run has no commands, or there is no such case.
        """
        run = self._stored()
        trace, row = stored_case(run, self._loader(**files), run.find_case(case), undisturbed=True)
        return trace.episode(row)

    def plot(self, metric: str | None = None) -> Image:
        """Draw the share of solved cases over time, or the distribution of a metric over the cases.

        Raises:
            InputError: The run has no such metric, or its values are all undefined.
        """
        from PIL import Image as Images

        from crowdbench.figures import plots

        require("metric", metric, isinstance(metric, str | None), "the name of a metric, or None")
        self._stored()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "figure.png"
            if metric is None:
                plots.success_over_time([self.directory], file)
            else:
                plots.distribution([self.directory], metric, file)
            with Images.open(file) as image:
                return image.convert("RGB")

    def view(self, case: int | str, *, web: bool = False, **files: Any) -> None:
        """Open a case in the Rerun viewer, and wait until it is closed.

        Args:
            case: The number of the case, or its name: "val/37".
            web: True to open it in a browser instead of a window.
            **files: See `Result`.

        Raises:
            InputError: The run has no commands, there is no such case, or the viewer does not start.
        """
        from crowdbench.record import viewer

        run = self._stored()
        number = run.find_case(case)
        with tempfile.TemporaryDirectory() as folder:
            recording = recording_of(run, self._loader(**files), number, Path(folder))
            viewer.view(recording, number, web=web)

    def render(self, case: int | str, **files: Any) -> Image:
        """Draw a case from above, as an image for a notebook or for its method `save("case.png")`.

        Args:
            case: The number of the case, or its name: "val/37".
            **files: See `Result`.

        Raises:
            InputError: The run has no commands, or there is no such case.
        """
        from crowdbench.envs.render import rasterize
        from crowdbench.figures.episode_figure import Episode

        run = self._stored()
        trace, row = stored_case(run, self._loader(**files), run.find_case(case))
        return rasterize(*Episode(trace, row).picture(), 300.0)

    def _stored(self) -> RunResult:
        """Return the run in the directory. Raises InputError if another run has replaced it."""
        run = RunResult.read(self.directory)
        if run.result["id"] != self.id:
            raise InputError(f"another run has replaced this one in {self.directory}: use its result instead")
        return run

    def _loader(
        self, pedestrians: str | Sequence[str] = (), layout: str | None = None, data: Path | str | None = None
    ) -> Loader:
        if self._loaded is not None:
            scenario = self._loaded
            return lambda run: scenario
        names = [pedestrians] if isinstance(pedestrians, str) else pedestrians
        return lambda run: load_stored_scenario(run, names, layout, None if data is None else Path(data))

    def __repr__(self) -> str:
        title = f"**{self.planner}** on {self.scenario}, cases {self.cases}"
        grid = metric_grid(title, self.metrics, self.episodes.rates, blocks=self.episodes.blocks.get("blocks"))
        return "\n\n".join(filter(None, [title, markdown(grid.header, grid.rows), grid.note]))

    def _repr_markdown_(self) -> str:
        """Return the Markdown that Jupyter shows."""
        return repr(self)


def find_earlier(directory: Path, run: Mapping[str, Any]) -> str:
    """Return the id of the run in a directory if it differs from a run at most by objects without a key of the author.

    The id is empty if the directory has no such run.

    Args:
        directory: The directory.
        run: The parts of the identity of the run, see `RunId.parts`.
    """
    try:
        earlier = read_result(directory)
    except InputError:
        return ""
    is_same = digest_of(without_random_key(earlier["run"])) == digest_of(without_random_key(run))
    return str(earlier["id"]) if is_same else ""


def as_path(name: str, path: object) -> Path:
    """Return the path of a directory. Raises InputError, with the name of the argument, if it is no path."""
    require(name, path, isinstance(path, str | Path) and "\0" not in str(path), "the path of a directory")
    return Path(str(path))
