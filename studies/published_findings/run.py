"""Check findings of other papers. Prints README.md."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Location
from studies.command import EngineOption, ShardOption, Sharing, make_runs, print_study

FILE = Path(__file__).with_name("run.toml")


@help_from_docstring
def published_findings(
    networks: Path,
    out: Path = Path("runs/study-published_findings"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Check findings of other papers, and print the page. Run it in the clone's root.

    Args:
        networks: Folder with dsrnn.safetensors and a folder pss_social with the weights of PSS-Social.
        out: Folder for the runs.
    """
    use_threads(threads)
    from studies.pages import read_file
    from studies.published_findings.findings import Finding, FindingsStudy, page

    spec = read_file(FILE, FindingsStudy)
    location = Location(FILE.name)
    findings = [Finding.load(each, networks, location.at("findings", i)) for i, each in enumerate(spec.findings)]
    make_runs([run for each in findings for run in each.runs], out, Sharing(shard, workers, engine, threads))
    filled = [each.fill(out) for each in findings]
    print_study(filled, [grid for each in filled for grid in each.grids], page(spec, filled), format)


if __name__ == "__main__":
    main(published_findings)
