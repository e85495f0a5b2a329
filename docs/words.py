"""Counts the words of the hand-written pages: python docs/words.py prints them, and fails above `MOST`.

Tables and captions count; blocks of code, pages that a command prints, and references do not.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST = 22_000
BLOCK = re.compile(r"^( *)```.*?^\1```", re.DOTALL | re.MULTILINE)


def pages() -> dict[Path, int]:
    """Return the number of words of each hand-written page of docs/ and studies/."""
    files = [*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "studies").glob("*/*.md"))]
    texts = {file: file.read_text() for file in files if file.name != "references.md"}
    written = {file: text for file, text in texts.items() if "Printed by `" not in text[:400]}
    return {file: len(BLOCK.sub("", text).split()) for file, text in written.items()}


def main() -> int:
    """Print the words of each page, and return their sum."""
    found = pages()
    for file, number in found.items():
        print(f"{number:6} {file.relative_to(ROOT)}")
    total = sum(found.values())
    print(f"{total:6} words on {len(found)} hand-written pages, {MOST} at most")
    return total


if __name__ == "__main__":
    sys.exit(main() > MOST)
