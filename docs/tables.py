"""The tables of studies as scripts, which the page of results loads: `studies/*/tables/*.csv`, and tables of pages."""

import csv
import json
import re
from pathlib import Path
from typing import Any

TABLE = re.compile(r"^\|.+\|\n\|[ :|-]+\|\n(?:\|.*\|\n?)+", re.MULTILINE)


def scripts(studies: Path) -> dict[str, str]:
    """Return a script for each study, and one that lists them, by file name.

    They are scripts instead of JSON, because a page that is opened from a file may load only scripts.
    """
    found = {folder.name: _tables(folder) for folder in sorted(studies.glob("*/"))}
    found = {name: tables for name, tables in found.items() if tables}
    listed = {name: [table["title"] for table in tables] for name, tables in found.items()}
    files = {f"{name}.js": f"addTables({json.dumps(name)}, {_json(tables)})\n" for name, tables in found.items()}
    return {**files, "list.js": f"const STUDIES = {_json(listed)}\n"}


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _tables(folder: Path) -> list[dict[str, Any]]:
    """Return the tables of a study, from its pages and from its CSV files."""
    tables = []
    for page in sorted(folder.glob("*.md")):
        title = folder.name
        for part in re.split(r"^(?=#)", page.read_text(), flags=re.MULTILINE):
            title = match[1] if (match := re.match(r"#+ (.+)", part)) else title
            blocks = [found[0] for found in TABLE.finditer(part)]
            for number, block in enumerate(blocks, 1):
                header, _, *rows = [split_row(line) for line in block.strip().splitlines()]
                name = f"{title} ({number})" if len(blocks) > 1 else title
                tables.append({"title": name, "header": header, "rows": rows})
    for file in sorted(folder.glob("tables/*.csv")):
        with file.open(newline="") as opened:
            header, *rows = csv.reader(opened)
        tables.append({"title": file.stem.replace("_", " "), "header": header, "rows": rows})
    return tables


def split_row(line: str) -> list[str]:
    """Return the cells of a row of a Markdown table as plain texts."""
    cells = re.split(r"(?<!\\)\|", line.strip().strip("|"))
    return [re.sub(r"\*\*|`|\[([^\]]*)\]\([^)]*\)", r"\1", cell).replace("\\|", "|").strip() for cell in cells]
