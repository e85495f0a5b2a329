"""Print texts of plug-ins without effects on terminals and on services that read logs."""

from __future__ import annotations

import re


def one_line(text: str, longest: int = 1000) -> str:
    """Return a text in one line, with escapes for what cannot be printed, and without commands such as `::error::`.

    Args:
        text: The text. It may contain a value of any length.
        longest: Largest number of characters. The middle of a longer text is left out.
    """
    line = "".join(item if item.isprintable() else ascii(item)[1:-1] for item in " ".join(text.split()))
    line = re.sub(r":(?=:)|##(?=\[)", r"\g<0> ", line)
    if len(line) > longest:
        return f"{line[: longest // 2]} ... {line[-longest // 2 :]}"
    return line
