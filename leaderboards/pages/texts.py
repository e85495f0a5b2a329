"""Numbers and texts as the pages show them. Entries are written by strangers, so that their texts are only data."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, urlsplit

from crowdbench.metrics import info_of

NOTHING = "\N{EN DASH}"
"""Shown where there is no value."""

LONGEST = 1000
"""Characters of a stranger's text that are shown."""

_ARXIV = re.compile(r"(?:arXiv:)?(\d{4}\.\d{4,5}(?:v\d+)?)", re.IGNORECASE)
_DOI = re.compile(r"(?:doi:)?(10\.\d{4,9}/[^\s<>\"]+)", re.IGNORECASE)


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with a fixed number of decimal places; a dash where it is undefined.

    Args:
        value: The number; None and NaN are undefined.
        digits: How many decimal places.
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) else text.removeprefix("-")


def metric(value: float | None, name: str) -> str:
    """Return a value of a metric as tables show it, in per cent where the metric is a share.

    Args:
        value: The value; None and NaN are undefined.
        name: The metric's name.
    """
    info = info_of(name)
    return number(None if value is None else info.factor * value, info.places)


def milliseconds(value: float) -> str:
    """Return a time with two or three digits that count."""
    return number(value, 0 if value >= 99.5 else 1 if value >= 9.95 else 2)


def sortable(value: float | None) -> str:
    """Return a number for the script that sorts; empty where it is undefined."""
    return "" if value is None or not math.isfinite(value) else f"{value:.9g}"


def shorten(text: str, longest: int = LONGEST) -> str:
    """Return a stranger's text without control characters, cut where it is too long for a page.

    Args:
        text: The text.
        longest: How many characters are shown.
    """
    plain = "".join(letter if letter.isprintable() else " " for letter in text)
    return plain if len(plain) <= longest else plain[: longest - 1] + "…"


def web_address(text: str) -> str:
    """Return the address of a paper or of code, if it is one of the web, an arXiv number or a DOI; otherwise empty."""
    text = text.strip()
    if len(text) > LONGEST or not text.isprintable():
        return ""
    if match := _ARXIV.fullmatch(text):
        return f"https://arxiv.org/abs/{match[1]}"
    if match := _DOI.fullmatch(text):
        return f"https://doi.org/{quote(match[1], safe='/')}"
    try:
        parts = urlsplit(text)
    except ValueError:
        return ""
    return text if parts.scheme in ("http", "https") and parts.hostname and " " not in text else ""


def options_text(options: Mapping[str, Any]) -> str:
    """Return the options of a planner as JSON."""
    return json.dumps(options, sort_keys=True, ensure_ascii=False)


MANNERS = ("at_fault_rate", "intimate_zone", "imposed_delay", "imposed_delay_positive", "jerk")
"""The metrics of manners, which stand with their intervals."""

FILTERS = number, metric, milliseconds, sortable, shorten, web_address, options_text
"""Filters of the templates, each by its own name."""
