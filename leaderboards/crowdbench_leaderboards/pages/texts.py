"""Numbers and texts of the pages. The texts of entries are untrusted, and treated only as data."""

from __future__ import annotations

import math
import re
from urllib.parse import quote, urlsplit

from crowdbench.metrics import info_of

NOTHING = "\N{EN DASH}"
"""Text of a missing value."""

LONGEST = 1000
"""Largest number of shown characters of an entry's text."""

_ARXIV = re.compile(r"(?:arXiv:)?(\d{4}\.\d{4,5}(?:v\d+)?)", re.IGNORECASE)
_DOI = re.compile(r"(?:doi:)?(10\.\d{4,9}/[^\s<>\"]+)", re.IGNORECASE)


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with a fixed number of decimal places; a dash if it is undefined.

    Args:
        value: The number; None and NaN are undefined.
        digits: Number of decimal places.
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) else text.removeprefix("-")


def metric(value: float | None, name: str) -> str:
    """Return a value of a metric as in tables, in per cent if the metric is a share.

    Args:
        value: The value; None and NaN are undefined.
        name: The metric's name.
    """
    info = info_of(name)
    return number(None if value is None else info.factor * value, info.places)


def sortable(value: float | None) -> str:
    """Return a number for the sorting script; empty if it is undefined."""
    return "" if value is None or not math.isfinite(value) else f"{value:.9g}"


def shorten(text: str, longest: int = LONGEST) -> str:
    """Return an entry's text without control characters, cut if it is too long for a page.

    Args:
        text: The text.
        longest: Largest number of shown characters.
    """
    plain = "".join(letter if letter.isprintable() else " " for letter in text)
    return plain if len(plain) <= longest else plain[: longest - 1] + "…"


def web_address(text: str) -> str:
    """Return the web address of a paper or of code, from an address, an arXiv number or a DOI; otherwise empty."""
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


COMPLIANCE = ("at_fault_rate", "intimate_zone", "imposed_delay", "imposed_delay_positive", "jerk")
"""The metrics of social compliance, which are shown with their intervals."""

FILTERS = number, metric, sortable, shorten, web_address
"""Filters of the templates, by the names of the functions."""
