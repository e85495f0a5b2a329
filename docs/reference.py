"""Writes the generated parts of the reference into the pages of docs/: `python docs/reference.py`.

A part stands between the comments `<!-- generated: NAME -->` and `<!-- end: NAME -->`, and is the Markdown that the
function NAME returns. Each planner has a page in docs/planners/. `--check` writes nothing, and fails if a page differs.
`docs/hooks.py` inserts `names_by_task` when the site is built, because only the site can show it.
"""

import dataclasses
import importlib
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterable
from enum import Enum
from pathlib import Path
from typing import Any, get_args

import heat_figure
from docstring_parser import DocstringStyle, parse
from typer.main import get_command

from crowdbench.catalog import scenario_path, scenarios
from crowdbench.check.kinds import KINDS
from crowdbench.cli.app import COMMANDS, app
from crowdbench.cli.listing import OptionRow, option_rows, parameter_rows
from crowdbench.core.types import observation
from crowdbench.metrics.registry import SUBJECTS, info_of
from crowdbench.networks.card import headline
from crowdbench.networks.weights import built_in, read_card

STYLE = DocstringStyle.GOOGLE
DOCS = Path(__file__).parent
SHOWN = 5
"""Largest number of links to failures of one kind on the page of a planner."""

PART = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end: \1 -->", re.DOTALL)


def commands() -> str:
    """Return every command with its arguments and options."""
    found = get_command(app).commands  # type: ignore[attr-defined]
    return "\n\n".join(_command(name, found[name]) for name in COMMANDS)


def _command(name: str, command: Any) -> str:
    arguments = [item for item in command.params if item.param_type_name == "argument"]
    usage = " ".join(["crowdbench", name, *(_metavar(item) for item in arguments), "[OPTIONS]"])
    entries = [(_names(item), _meaning(item)) for item in command.params if item.name != "help"]
    return f"### {name}\n\n{_paragraphs(command.help)}\n\n```\n{usage}\n```\n\n{_definitions(entries)}"


def _metavar(item: Any) -> str:
    text = item.name.upper() + ("..." if item.nargs == -1 else "")
    return text if item.required else f"[{text}]"


def _names(item: Any) -> str:
    if item.param_type_name == "argument":
        return f"`{item.name.upper()}`"
    return f"`{', '.join(item.opts)}{'' if item.is_flag else ' ' + _kind(item.type_descriptor.annotation)}`"


def _kind(annotation: Any) -> str:
    """Return the choices of an option, or the kind of its value in capitals."""
    choices = get_args(annotation)
    annotation, *_ = [*choices, annotation]
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return "|".join(str(each.value) for each in annotation)
    if isinstance(annotation, str):  # of a Literal
        return "|".join(choices)
    return {int: "N", float: "NUMBER", str: "TEXT"}.get(annotation, "PATH")


def _meaning(item: Any) -> str:
    default = item.show_default if isinstance(item.show_default, str) else item.default
    shown = default not in (None, False, (), [], ...) and not callable(default) and "REQUIRED" not in repr(default)
    shown = shown and "UNSET" not in repr(default)
    said = default if default is item.show_default else f"`{getattr(default, 'value', default)}`"
    text = f" Default: {said}." if shown else ""
    return _one_line(item.help or "") + text


def planners() -> str:
    """Return a table of all planners, the best ones on the suite first, with links to their pages."""
    scores, drives = heat_figure.scores(), game()
    others = [name for name, _ in KINDS["planners"].names() if name not in scores]
    names = [*scores, *sorted(others, key=lambda name: -drives.get(name, []).count("success"))]
    rows = []
    for name in names:
        first = _cell(KINDS["planners"].docstring(name).partition("\n")[0])
        both = [f"{scores[name][track]:.2f}" if name in scores else "" for track in heat_figure.MEANS]
        crossed = f"{drives[name].count('success')} of {len(drives[name])}" if name in drives else ""
        rows.append(f"| [`{name}`](planners/{name}.md) | {first} | {' | '.join(both)} | {crossed} |")
    return "\n".join(
        ["| planner | method | score, perfect | score, realistic | crowds crossed |", "|---|---|---|---|---|", *rows]
    )


def planner_page(name: str) -> str:
    """Return the page of a planner: its method, its options, its results and its failures."""
    plugins, scores, drives = KINDS["planners"], heat_figure.scores().get(name), game().get(name, [])
    _, factory = plugins.find(name)
    entries = [(_option_name(row), _option_meaning(row)) for row in option_rows(factory)]
    parts = [f"# {name}", _paragraphs(plugins.docstring(name))]
    parts.append(f"```sh\ncrowdbench run --planner {name} --scenario circle_20 --cases val:20\n```")
    if scores:
        titles = {**heat_figure.MEANS, **{name: f"`{name}`, {title}" for name, title in heat_figure.COLUMNS.items()}}
        rows = [f"| {title} | {scores[each]:.2f} |" for each, title in titles.items()]
        parts += ["## Score on the suite", "\n".join(["| scenarios | score |", "|---|---|", *rows])]
        parts.append("[Score](../methods.md#score) in validation cases of [the suite](../suite.md), 1 at most.")
    if drives:
        failed = {end: [case for case, found in enumerate(drives) if found == end] for end in ("collision", "timeout")}
        counts = [f"{len(cases)} {end}{'s' * (len(cases) != 1)}" for end, cases in failed.items() if cases]
        links = [f"[val/{case}](../index.md#val/{case}:{name})" for cases in failed.values() for case in cases[:SHOWN]]
        crossed = f"{drives.count('success')} of {len(drives)} crowds of `circle_20_blind`"
        text = f"It crosses {crossed}, with realistic sensing and people who do not see it."
        text += f" Failures: {' and '.join(counts)}." if counts else ""
        watch = f" Watch it fail, or drive yourself: {', '.join(links)}." if links else ""
        parts += ["## In the game of the start page", text + watch, f"<!-- figure: paths of {name} -->"]
    parts += ["## Options", _definitions(entries) if entries else "It has no options."]
    return "\n\n".join(parts) + "\n"


def game() -> dict[str, list[str]]:
    """Return the outcomes of each planner in the cases of the start page's game."""
    outcomes: dict[str, list[str]] = {}
    files = sorted((DOCS / "cross/cases").glob("[0-9]*.js"), key=lambda path: int(path.stem))
    for path in files:
        data = json.loads(path.read_text().removeprefix("cross.take(").rstrip().removesuffix(")"))
        for planner in data["planners"]:
            outcomes.setdefault(planner["name"], []).append(planner["outcome"])
    return outcomes


def predictors() -> str:
    """Return every predictor with its options."""
    return _plugins("predictors", option_rows)


def layouts() -> str:
    """Return every layout with its options."""
    return _plugins("layouts", lambda factory: option_rows(factory, keyword_only=True))


def pedestrians() -> str:
    """Return every pedestrian policy with its parameters."""
    return _plugins("pedestrians", None)


def _plugins(kind: str, rows: Callable[[Any], list[OptionRow]] | None) -> str:
    plugins, parts = KINDS[kind], []
    for name, _ in plugins.names():
        plugin, factory = plugins.find(name)
        text = parse(factory.__doc__ or "", STYLE).description if plugins.functions else None
        options = rows(factory) if rows else parameter_rows(plugin, factory)
        entries = [(_option_name(row), _option_meaning(row)) for row in options]
        parts.append(f"### {name}\n\n{_paragraphs(text or plugins.docstring(name))}\n\n{_definitions(entries)}")
    return "\n\n".join(parts)


def _option_name(row: OptionRow) -> str:
    default = f" = {row.default}" if row.default not in ("", "as below") else ""
    name = row.name.strip().rpartition(".")[2] if row.name.startswith("pedestrians.") else row.name.strip()
    return f"{'&emsp;' * row.name.startswith('  ')}`{name}{default}`"


def _option_meaning(row: OptionRow) -> str:
    unit = f" Unit: {row.unit}." if row.unit not in ("", "1") else ""
    return f"{_one_line(row.meaning)}{unit}"


def weights() -> str:
    """Return a table of the built-in weights, with one line from the card of each."""
    rows = [f"| `{path.stem}` | {_cell(headline(read_card(path)))} |" for path in built_in()]
    return "\n".join(["| weights | training and result |", "|---|---|", *rows])


def scenario_list() -> str:
    """Return the built-in scenarios, by folder."""
    folders: dict[str, list[str]] = {}
    for name, description in scenarios():
        path = scenario_path(name)
        folders.setdefault(path.parent.name, []).append(f"| `{name}` | {_cell(description)} |")
    head = "| scenario | description |\n|---|---|\n"
    return "\n\n".join(f"### Folder {folder}\n\n{head}" + "\n".join(rows) for folder, rows in folders.items())


def metrics() -> str:
    """Return every metric with its unit, direction and source, by subject."""
    return "\n\n".join(
        f"### {subject.capitalize()}\n\n{_definitions((f'`{each.__name__}`', _metric(each)) for each in functions)}"
        for subject, functions in SUBJECTS.items()
    )


def _metric(function: Callable[..., Any]) -> str:
    info = info_of(function.__name__)
    parts = [f"Table heading: {info.heading}.", f"Better: {info.better}." if info.better else ""]
    parts.append(f"Source: {info.source.rstrip('.')}." if info.source else "")
    text = parse(function.__doc__ or "", STYLE).description or ""
    return f"{_paragraphs(text)}\n\n{' '.join(filter(None, parts))}"


def observation_fields() -> str:
    """Return the fields and methods of an observation, with shapes."""
    parts = []
    for title, kind in (
        ("obs", observation.Observation),
        ("obs.vehicle", observation.Vehicle),
        ("obs.pedestrians", observation.Pedestrians),
    ):
        texts = {entry.arg_name: entry.description for entry in parse(kind.__doc__ or "", STYLE).params}
        entries = [
            (f"`{field.name}` {_shape(field.type)}", texts[field.name] or "") for field in dataclasses.fields(kind)
        ]
        for name, value in vars(kind).items():
            if not name.startswith("_") and _is_documented(value):
                entries.append((f"`{name}{_signature(value)}`", parse(value.__doc__, STYLE).description or ""))
        parts.append(f"### {title}\n\n{_definitions((name, _paragraphs(text)) for name, text in entries)}")
    return "\n\n".join(parts)


def _is_documented(value: object) -> bool:
    return (inspect.isfunction(value) or isinstance(value, property)) and bool(value.__doc__)


def _signature(value: Any) -> str:
    if isinstance(value, property):
        return ""
    return f"({', '.join(name for name in inspect.signature(value).parameters if name != 'self')})"


def _shape(annotation: object) -> str:
    found = re.search(r"\w+\[np\.ndarray, ['\"]\*?([\w ]*)['\"]\]", str(annotation))
    return f"`[{', '.join(found[1].split())}]`" if found else ""


def names_by_task(page: str) -> str:
    """Return the page of the Python API with the public classes and functions of each task below the table of the task.

    They are directives of mkdocstrings. The names in the tables become links to them.
    """
    return "".join(_with_names(section) for section in re.split(r"^(?=## )", page, flags=re.MULTILINE))


def _with_names(section: str) -> str:
    """Return a section of the page of the Python API with its classes and functions."""
    parts = [section.rstrip()]
    for row, door, names in re.findall(r"^(\| `([\w.]+)` \| (.*) \|)$", section, re.MULTILINE):
        module = importlib.import_module(door)
        found = [name for name in re.findall(r"`(\w+)`", names) if _is_class_or_function(getattr(module, name))]
        linked = row
        for name in found:
            linked = linked.replace(f"`{name}`", f"[`{name}`][{door}.{name}]", 1)
        parts[0] = parts[0].replace(row, linked)
        parts += [f"**From `{door}`**", *(f"::: {door}.{name}" for name in found)] if found else []
    return "\n\n".join(parts) + "\n\n"


def _is_class_or_function(public: object) -> bool:
    """Return whether a public name is a class or a function of the package; false for types of arrays and constants."""
    is_ours = getattr(public, "__module__", "").startswith("crowdbench")
    return is_ours and (inspect.isclass(public) or inspect.isfunction(inspect.unwrap(public)))  # type: ignore[arg-type]


def _paragraphs(text: str) -> str:
    """Return a docstring without its indentation."""
    return inspect.cleandoc(text).strip()


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("<", "&lt;")


def _cell(text: str) -> str:
    return _one_line(text).replace("|", r"\|")


def _definitions(entries: Iterable[tuple[str, str]]) -> str:
    """Return a definition list, which is readable on a phone."""
    return "\n\n".join(f"{name}\n:   " + (text or "—").replace("\n", "\n    ") for name, text in entries)


def pages() -> dict[Path, str]:
    """Return the text of each page that has generated parts."""
    found = {DOCS / "planners" / f"{name}.md": planner_page(name) for name, _ in KINDS["planners"].names()}
    for path in sorted(DOCS.glob("*.md")):
        text = path.read_text()
        if PART.search(text):
            found[path] = PART.sub(lambda part: _part(part[1]), text)
    return found


def _part(name: str) -> str:
    return f"<!-- generated: {name} -->\n\n{globals()[name]()}\n\n<!-- end: {name} -->"


def main(check: bool) -> None:
    """Write the pages, or exit with the names of pages that differ."""
    others = []
    for path, text in pages().items():
        if not path.exists() or path.read_text() != text:
            others.append(path.relative_to(DOCS).as_posix())
            if not check:
                path.parent.mkdir(exist_ok=True)
                path.write_text(text)
    sys.exit(f"python docs/reference.py writes {', '.join(others)}" if check and others else 0)


if __name__ == "__main__":
    main("--check" in sys.argv)
