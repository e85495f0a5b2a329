"""Renders the templates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from crowdbench.boards.site import texts
from crowdbench.boards.site.output import MARK

HERE = Path(__file__).parent
TEMPLATES = HERE / "templates"
STYLE = HERE / "style.css"


def environment() -> jinja2.Environment:
    """The templates, which escape every text that they are given."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {
        "number": texts.number,
        "metric": texts.metric,
        "milliseconds": texts.milliseconds,
        "p_text": texts.p_text,
        "sortable": texts.sortable,
        "short": texts.shortened,
        "web_address": texts.web_address,
        "options": texts.options_text,
    }
    made.globals |= {
        "METRICS": texts.METRICS,
        "MARK": Markup(MARK),
        "SORT": Markup((TEMPLATES / "sort.js").read_text(encoding="utf-8")),
    }
    return made


def write_page(templates: jinja2.Environment, template: str, path: Path, **values: Any) -> None:
    """Render a page.

    Args:
        templates: The templates.
        template: The name of one of them.
        path: The page.
        **values: What it shows.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    text = templates.get_template(template).render(**values)
    path.write_text(text, encoding="utf-8", errors="replace", newline="\n")
