"""Draw the picture of the page about the studio, in a headless Chromium: ``python docs/draw_studio.py``."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from chromium_pages import Chromium

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "figures" / "studio.png"


def main(
    file: str = "validation/presentation/studio/template_first.toml", width: int = 1400, height: int = 900
) -> bytes:
    """Open a file in the studio, certify it, play its episodes, and return the page as PNG."""
    from certigym.validation.presentation.studio import Studio

    with TemporaryDirectory() as folder:
        (Path(folder) / "task.toml").write_text((ROOT / file).read_text(encoding="utf-8"), encoding="utf-8")
        page = Studio(Path(folder), "task.toml").start()
        browser = Chromium(Path(folder) / "profile")
        try:
            tab = browser.open(page.address, width, height)
            tab.until("window.studio && document.querySelector('#panels .body')")
            tab.until("!document.getElementById('certify').disabled")
            tab.click("#certify")
            tab.until("studio.link.state.job.state === 'done'", 300.0)
            tab.click("#play")
            tab.until("studio.result.run && +document.getElementById('time').value >= 8")
            tab.click("#play")
            tab.run("document.querySelector('#panels .body').focus(); scrollTo(0, 0)")
            tab.screenshot(PICTURE)
            assert tab.run("wrong") == []
            return PICTURE.read_bytes()
        finally:
            browser.close()
            page.stop()


if __name__ == "__main__":
    from PIL import Image

    found = Image.open(io.BytesIO(main(*sys.argv[1:2], *map(int, sys.argv[2:4]))))
    found.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(PICTURE, optimize=True)
    print(f"{PICTURE.name}: {PICTURE.stat().st_size // 1024} KiB")
