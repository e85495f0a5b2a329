"""A hook of MkDocs: the pages of studies/ are pages of the site, and links between them and docs/ follow."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

STUDIES = Path(__file__).parent.parent / "studies"


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and figures of the studies."""
    for path in sorted([*STUDIES.glob("*/*.md"), *STUDIES.glob("*/*.png")]):
        uri = path.relative_to(STUDIES.parent).as_posix()
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **kwargs: Any) -> str:
    """Let links lead to where a page is on the site."""
    if page.file.src_uri.startswith("studies/"):
        return markdown.replace("](../../docs/", "](../../")
    return markdown.replace("](../studies/", "](studies/")
