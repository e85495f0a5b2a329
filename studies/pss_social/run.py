"""Drive the networks of a paper in its scene and in ours, and our planners in its scene. Prints README.md."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Location
from studies.command import EngineOption, ShardOption, Sharing, make_runs

FILE = Path(__file__).with_name("run.toml")


@help_from_docstring
def pss_social(
    networks: Path,
    file: Path = FILE,
    out: Path = Path("runs/study-pss_social"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Drive the networks of PSS-Social in its scene and in ours, and our planners in its scene.

    Run it in the clone's root.

    Args:
        networks: Folder with the paper's weights, such as pss_social-seed9.safetensors.
        file: The scenes and the planners.
        out: Folder for the runs.
    """
    use_threads(threads)
    from studies.pages import print_page, read_file
    from studies.pss_social.table import HostedStudy, SceneTable

    spec, location = read_file(file, HostedStudy), Location(file.name)
    tables = [SceneTable.of(each, networks, location.at("scenes", i)) for i, each in enumerate(spec.scenes)]
    make = functools.partial(make_runs, out=out, sharing=Sharing(shard, workers, engine, threads))
    print_page(spec, tables, "python studies/pss_social/run.py DIR", out, make, format)


if __name__ == "__main__":
    main(pss_social)
