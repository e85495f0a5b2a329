"""Hooks of MkDocs: pages of studies, tables as data, a replay, and the parts that are generated from the code.

`docs/reference.py` writes the other generated parts into the pages.
"""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.append(str(Path(__file__).parent))

import notebook_page
import pareto_figure
import path_figure
import reference
import replays
import tables

STUDIES = Path(__file__).parent.parent / "studies"
TUTORIALS = ("quickstart", "notebook", "planner", "training", "recordings")
BOOST = dict.fromkeys(TUTORIALS, 3) | {"architecture": 0.3, "results": 0.5, "references": 0.3, "index": 0.5}
"""Weights of pages in the search, 1 for all others; it excludes the pages of studies."""

WIDE = ("index", "results")
"""Pages without a menu at the side."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and figures of the studies, their tables as data, the replay of the suite, and the notebook."""
    for path in sorted([*STUDIES.glob("*/*.svg"), *STUDIES.glob("*/*.webp")]):
        files.append(File.generated(config, path.relative_to(STUDIES.parent).as_posix(), abs_src_path=str(path)))
    for path in sorted(STUDIES.glob("*/*.md")):
        uri = path.relative_to(STUDIES.parent).as_posix()
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    for name, content in tables.scripts(STUDIES).items():
        files.append(File.generated(config, f"tables/{name}", content=content))
    for uri, data in {**replays.files(), **notebook_page.files()}.items():
        files.append(File.generated(config, uri, content=data))
    return files


def on_page_markdown(markdown: str, page: Any, **kwargs: Any) -> str:
    """Insert the generated parts, and adapt links to the addresses of pages on the site."""
    if page.file.src_uri.startswith("leaderboards/"):
        return markdown
    page.meta["search"] = {"boost": BOOST.get(Path(page.file.src_uri).stem, 1)}
    if page.file.src_uri in map("{}.md".format, WIDE):
        page.meta["hide"] = ["navigation", "toc"]
    if page.file.src_uri.startswith("studies/"):
        page.meta["search"] = {"exclude": True}
        if not re.search(r"^# ", markdown, re.MULTILINE):
            study = Path(page.file.src_uri).parent.name
            markdown = f"# Study: {study}\n\n{markdown}"
        return re.sub(
            r"\]\((tables/[\w-]+\.csv)\)", "](../../results.md)", markdown.replace("](../../docs/", "](../../")
        )
    if page.file.src_uri == "api.md":
        markdown = reference.names_by_task(markdown)
    # Cases of the game are no headings of the start page, which links to headings are checked against.
    link = re.compile(r"\[(val/\d+)\]\(\.\./index\.md#(val/\d+:\w+)\)")
    markdown = link.sub(r'<a href="../index.html#\2">\1</a>', markdown)
    markdown = markdown.replace("<!-- figure: pareto -->", pareto_figure.figure())
    paths = re.compile(r"<!-- figure: paths of (\w+) -->")
    markdown = paths.sub(lambda found: path_figure.figures(found[1], reference.game()[found[1]]), markdown)
    if page.file.src_uri == notebook_page.SOURCE.name:
        markdown = notebook_page.page()
    if Path(page.file.src_uri).stem in replays.LINKING:
        markdown = replays.add_links(markdown)
    return markdown.replace("](../studies/", "](studies/").replace(
        "](../leaderboards/README.md", "](leaderboards/index.md"
    )
