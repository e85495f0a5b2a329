"""Makes a notebook of docs/notebook.md, executes it, and shows its outputs on the page of the site."""

import base64
import functools
import re
import tempfile
from pathlib import Path
from typing import Any

import nbclient
import nbformat

SOURCE = Path(__file__).with_name("notebook.md")
NAME = "notebook.ipynb"

LONGEST = 120
"""Seconds that a cell may take."""


def read_notebook() -> nbformat.NotebookNode:
    """Return the page as a notebook: its blocks of Python are cells of code, the text between them of Markdown."""
    notebook = nbformat.v4.new_notebook()
    for number, part in enumerate(re.split(r"^```python\n(.*?)^```\n", SOURCE.read_text(), flags=re.DOTALL | re.M)):
        if text := part.strip():
            cell = nbformat.v4.new_code_cell(text) if number % 2 else nbformat.v4.new_markdown_cell(text)
            notebook.cells.append({**cell, "id": f"cell-{number}"})
    return nbformat.from_dict(notebook)


@functools.cache
def execute() -> nbformat.NotebookNode:
    """Return the notebook with its outputs. Raises CellExecutionError if a cell raises."""
    notebook = read_notebook()
    with tempfile.TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        nbclient.NotebookClient(notebook, timeout=LONGEST, kernel_name="python3", resources=place).execute()
    return notebook


def files() -> dict[str, bytes]:
    """Return the executed notebook and its pictures, by their paths on the site."""
    notebook = execute()
    found = {NAME: nbformat.writes(notebook).encode()}
    for number, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", []):
            if picture := output.get("data", {}).get("image/png"):
                found[_picture(number)] = base64.b64decode(picture)
    return found


def page() -> str:
    """Return the page in Markdown with the outputs of its cells, and a link to the notebook."""
    parts = []
    for number, cell in enumerate(execute().cells):
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        else:
            parts.append(f"```python\n{cell.source}\n```")
            parts += filter(None, [_show(output.get("data", {}), number) for output in cell.outputs])
    title, *others = parts[0].split("\n\n")
    return "\n\n".join([title, f"[Download this page as a notebook]({NAME})", *others, *parts[1:]])


def _show(data: dict[str, Any], number: int) -> str:
    """Return an output in Markdown; empty for messages, such as progress."""
    if "image/png" in data:
        return f"![Output of the cell]({_picture(number)})"
    if "text/html" in data:
        return f'<div class="output">{data["text/html"]}</div>'
    if "text/markdown" in data:
        return f'<div class="output" markdown>\n\n{data["text/markdown"]}\n\n</div>'
    return f"```text\n{data['text/plain']}\n```" if "text/plain" in data else ""


def _picture(number: int) -> str:
    return f"notebook/{number}.png"
