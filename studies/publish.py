"""Write a printed page beside its study: `python studies/run.py FILE | python studies/publish.py FOLDER`.

The page keeps the tables of its sections. The tables of subsections, one of each scenario, become CSV files in the
folder `tables`, which the documentation shows as data.
"""

from __future__ import annotations

import csv
import io
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from crowdbench.cli import help_from_docstring, main

TABLE = re.compile(r"^\|.+\|\n\|[ :|-]+\|\n(?:\|.*\|\n?)+", re.MULTILINE)
PRINTED = re.compile(r"^Printed by `.+`\.$", re.MULTILINE)
GENERATED = "<!-- Do not edit this page: the command overwrites it. -->"
PAIRS = "significantly better or worse than"


def publish(page: str) -> tuple[str, dict[str, str]]:
    """Split a printed page.

    Args:
        page: The Markdown that a study prints.

    Returns:
        The page with a link in place of the tables of each subsection, and CSV files by name.
    """
    files: dict[str, str] = {}
    sections = []
    page = PRINTED.sub(lambda line: f"{line[0]} {GENERATED}", page, count=1)
    for section in re.split(r"^(?=## )", page, flags=re.MULTILINE):
        head, *parts = re.split(r"^(?=### )", section, flags=re.MULTILINE)
        rows: dict[str, list[dict[str, str]]] = {}
        notes: dict[str, None] = {}
        for part in parts:
            title = part.splitlines()[0].removeprefix("### ")
            for table in TABLE.findall(part):
                name, header, lines = _long(table)
                found = [{"scenario": title, **dict(zip(header, line, strict=False))} for line in lines]
                rows.setdefault(name, []).extend(found)
            text = TABLE.sub("", part).partition("\n")[2]
            notes |= dict.fromkeys(filter(None, map(str.strip, text.split("\n\n"))))
        title = _file_name(section.splitlines()[0]) if rows else ""
        files |= {f"{title}{name}.csv": _csv(records) for name, records in rows.items()}
        links = ", ".join(f"[{title}{name}.csv](tables/{title}{name}.csv)" for name in rows)
        sections.append(head.rstrip("\n") + (f"\n\nEach scenario: {links}." if links else ""))
        sections += notes
    return "\n\n".join(sections) + "\n", files


def _long(table: str) -> tuple[str, list[str], list[list[str]]]:
    """Return the end of a file's name, the header and the rows; a table of pairs has a row for each pair."""
    header, _, *rows = [_cells(line) for line in table.strip().splitlines()]
    if header[0] != PAIRS:
        return "", header, rows
    pairs = [[row[0], other, *_verdict(cell)] for row in rows for other, cell in zip(header[1:], row[1:], strict=False)]
    return "_pairs", ["planner", "other planner", "better", "worse", "note"], [pair for pair in pairs if any(pair[2:])]


def _verdict(cell: str) -> Iterator[str]:
    for kind in ("better", "worse"):
        found = re.search(rf"{kind}: ([^;(]+)", cell)
        yield found[1].strip() if found else ""
    note = re.search(r"\(([^)]*)\)", cell)
    yield note[1] if note else "" if re.search(r"better|worse", cell) else cell


def _cells(line: str) -> list[str]:
    cells = re.split(r"(?<!\\)\|", line.strip().strip("|"))
    return [re.sub(r"\*\*|`", "", cell).replace("\\|", "|").strip() for cell in cells]


def _file_name(heading: str) -> str:
    return re.sub(r"\W+", "_", heading.lower()).strip("_")


def _csv(records: Sequence[dict[str, str]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, dict.fromkeys(name for record in records for name in record), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


@help_from_docstring
def write(folder: Path) -> None:
    """Write the page from standard input into the folder of a study.

    Args:
        folder: The folder, such as studies/suite.
    """
    page, files = publish(sys.stdin.read())
    (folder / "README.md").write_text(page, encoding="utf-8")
    if files:
        (folder / "tables").mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / "tables" / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(write)
