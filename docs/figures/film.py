"""A film of the sample drive: `python docs/figures/film.py` writes docs/images/sample.gif.

It is `homeward studio sample --estimator robust`, slid through in Chromium and photographed.
"""

import sys
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
FRAMES, FRAME_MS, LAST_MS = 60, 120, 2500
SIZE = (900, 560)
COLOURS = 48
SLIDE = """(() => { const s = document.querySelector('#moment');
  s.value = SHARE * s.max; s.dispatchEvent(new Event('input')); })()"""
TIDY = "for (const d of document.querySelectorAll('details')) d.hidden = true"


def main():
    """Make it."""
    sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "studio")]
    from chromium import studio  # the hand that tests drag with, too

    frames = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        photo, words = Path(scratch) / "photo.png", ("sample", "--estimator", "robust")
        with studio(Path(scratch), *words, width=SIZE[0], height=SIZE[1]) as page:
            page.find(TIDY)
            for k in range(FRAMES):
                page.find(SLIDE.replace("SHARE", str((k + 1) / FRAMES)))
                page.find(
                    "new Promise((done) => requestAnimationFrame(() => setTimeout(done, 60)))"
                )
                page.picture(photo)
                frames.append(Image.open(BytesIO(photo.read_bytes())).convert("RGB"))
    palette = frames[-1].quantize(COLOURS)
    plain = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [FRAME_MS] * (FRAMES - 1) + [LAST_MS]
    out = ROOT / "docs" / "images" / "sample.gif"
    plain[0].save(out, save_all=True, append_images=plain[1:], duration=times, loop=0)


if __name__ == "__main__":
    main()
