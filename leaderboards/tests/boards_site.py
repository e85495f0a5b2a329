"""The documentation site with few pages and with the boards of a given folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from crowdbench.plugins.kind import load_module

ROOT = Path(__file__).parents[2]
tables = load_module(ROOT / "docs" / "tables.py")

CONFIGURATION = f"""
INHERIT: {ROOT}/mkdocs.yml
docs_dir: docs
hooks: [{ROOT}/leaderboards/crowdbench_leaderboards/pages/hook.py]
plugins: [search]
nav: [index.md, boards.md, boards_rules.md, trust.md, suite.md, results.md, Leaderboards: leaderboards/index.md]
"""
"""The site without its other hooks and pages."""


def build_site(root, place):
    """Build the pages of a folder of boards, and return the folder of the site."""
    pytest.importorskip("material", reason="needs the extra docs")
    docs = place / "docs"
    (docs / "tables").mkdir(parents=True, exist_ok=True)
    (place / "mkdocs.yml").write_text(CONFIGURATION)
    shutil.copytree(ROOT / "docs" / "theme", docs / "theme", dirs_exist_ok=True)
    for name in ("style.css", "tables.js"):
        shutil.copy(ROOT / "docs" / name, docs)
    for name in ("index", "boards", "boards_rules", "trust", "suite"):
        (docs / f"{name}.md").write_text(f"# {name}\n\n## Ranking\n\n## Other studies\n")
    (docs / "results.md").write_text((ROOT / "docs/results.md").read_text().split("Each study has a page")[0])
    for name, script in tables.scripts(ROOT / "studies").items():
        (docs / "tables" / name).write_text(script)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", place / "mkdocs.yml", "-d", place / "site"]
    more = {"BOARDS": str(root), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **more})
    assert done.returncode == 0, done.stderr
    return place / "site"
