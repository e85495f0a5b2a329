"""Draws the film of the README and the card of the site from the game of the start page, with Chromium."""

import base64
import contextlib
import io
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from PIL import Image
from viewer_picture import NoViewer

DOCS = Path(__file__).parent
SIDE, RATE, SPEED, END, REST = 460, 10, 2.0, 13.0, 1.5
"""Pixels, pictures in a second, seconds of the case in a second, its last time, and seconds for which that is shown."""

CARD = """body { margin: 0 !important; padding: 0 !important; background: #111318; color: #fff; }
body { font-family: system-ui, sans-serif; }
main { display: grid; grid-template-columns: 570px 630px; height: 630px; }
div { display: flex; flex-direction: column; justify-content: center; padding-left: 60px; }
h1 { margin: 0 0 20px; font-size: 68px; line-height: 1.05; }
p { margin: 0; font-size: 34px; line-height: 1.35; color: #c9ccd4; }
footer { margin-top: 70px; font-size: 30px; font-weight: 700; color: #ffb428; }
img { width: 630px; height: 630px; }"""
"""The style of the card."""


def page() -> str:
    """Return the game of the start page as a page of its own, without the theme."""
    text = (DOCS / "index.md").read_text()
    game = text[text.index("<link") : text.rindex("</script>") + len("</script>")]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    return f'<!doctype html>{head}<body class="md-typeset" style="margin: 0; padding: 0 .8rem">{game}'


@contextlib.contextmanager
def open_game(scheme: str, side: int, width: int, height: int) -> Iterator[Any]:
    """Open the game in Chromium.

    Args:
        scheme: "default" for the light theme, "slate" for the dark one.
        side: Side of the picture of the game in pixels.
        width: Width of the window.
        height: Its height.

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
        tab = browser.new_page(viewport={"width": width, "height": height})
        tab.goto((Path(place) / "index.html").as_uri())
        tab.evaluate(f"document.body.dataset.mdColorScheme = '{scheme}'")
        tab.add_style_tag(content=f".cross-stage canvas {{ width: {side}px !important; margin: 0 }}")
        tab.wait_for_function("cross.isOpen()")
        tab.wait_for_timeout(500)
        yield tab


def draw_cross(scheme: str, out: Path) -> None:
    """Draw the film in a theme, see `open_game`, to a .webp file."""
    number = round(END / SPEED * RATE)
    with open_game(scheme, SIDE, 900, 900) as tab:
        urls = [tab.evaluate(f"cross.pose({k * SPEED / RATE})") for k in range(number + 1)]
    pictures = [Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB") for url in urls]
    times = [round(1000 / RATE)] * number + [round(1000 * REST)]
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=times, loop=0, quality=70, method=4)


def draw_card(out: Path) -> None:
    """Draw the picture that other sites show beside a link to the documentation, 1200 by 630 pixels."""
    with open_game("slate", 630, 1200, 630) as tab:
        tab.set_viewport_size({"width": 1200, "height": 630})
        tab.evaluate("""() => {
            const url = cross.pose(5.2);
            document.body.innerHTML = `<main><div><h1>Can you cross?</h1>
                <p>23 planners and you,<br>in the same crowd</p><footer>crowdbench</footer></div>
                <img src="${url}"></main>`;
        }""")
        tab.add_style_tag(content=CARD)
        tab.wait_for_timeout(300)
        picture = tab.screenshot()
    Image.open(io.BytesIO(picture)).convert("RGB").quantize(dither=Image.Dither.NONE).save(out, optimize=True)
