"""Draws the film of the README, the planners on the first case of the start page's game, with Chromium."""

import base64
import contextlib
import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from viewer_picture import NoViewer

DOCS = Path(__file__).parent
SIDE, RATE, SPEED, END, REST = 460, 10, 2.0, 13.0, 1.5
"""Pixels, pictures in a second, seconds of the case in a second, its last time, and seconds for which that is shown."""


def page() -> str:
    """Return the game of the start page as a page of its own, without the theme."""
    text = (DOCS / "index.md").read_text()
    game = text[text.index("<link") : text.rindex("</script>") + len("</script>")]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    return f'<!doctype html>{head}<body class="md-typeset" style="margin: 0; padding: 0 .8rem">{game}'


def draw_cross(scheme: str, out: Path) -> None:
    """Draw the film.

    Args:
        scheme: "default" for the light theme, "slate" for the dark one.
        out: A .webp file.

    Raises:
        NoViewer: Playwright or Chromium is missing.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise NoViewer("it needs playwright") from error
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise NoViewer("it needs Chromium")
    with (
        tempfile.TemporaryDirectory() as place,
        sync_playwright() as started,
        contextlib.closing(started.chromium.launch(executable_path=chromium)) as browser,
    ):
        shutil.copytree(DOCS / "cross", Path(place) / "cross")
        (Path(place) / "index.html").write_text(page())
        tab = browser.new_page(viewport={"width": 900, "height": 900})
        tab.goto((Path(place) / "index.html").as_uri())
        tab.evaluate(f"document.body.dataset.mdColorScheme = '{scheme}'")
        tab.add_style_tag(content=f".cross-stage canvas {{ width: {SIDE}px !important; margin: 0 }}")
        tab.wait_for_function("cross.isOpen()")
        tab.wait_for_timeout(500)
        number = round(END / SPEED * RATE)
        urls = [tab.evaluate(f"cross.pose({k * SPEED / RATE})") for k in range(number + 1)]
    pictures = [Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB") for url in urls]
    times = [round(1000 / RATE)] * number + [round(1000 * REST)]
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=times, loop=0, quality=70, method=4)
