"""Make the pictures of README and docs again: `.venv/bin/python docs/make_pictures.py`.

Pages are drawn by Chromium, which must be on the PATH.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from homeward.report.run_folder import write_run
from homeward.studies.single_run import SAMPLE, RunSettings, execute

IMAGES = Path(__file__).parent / "images"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SIZE, MOMENT_S = (860, 1400), 87.0


def main() -> None:
    """Picture the top of the sample drive's report."""
    if CHROMIUM is None:
        sys.exit("no chromium on the PATH")
    drive, track, settings = execute(RunSettings(drive=SAMPLE))
    with tempfile.TemporaryDirectory() as scratch:
        write_run(Path(scratch), drive, track, settings.model_dump(mode="json"))
        _picture(Path(scratch) / "report.html", IMAGES / "sample-report.png")


def _picture(page: Path, file: Path) -> None:
    """Draw the top of a page, at a moment of its drive."""
    subprocess.run(
        [
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--virtual-time-budget=8000",
            f"--window-size={SIZE[0]},{SIZE[1]}",
            f"--screenshot={file}",
            f"{page.as_uri()}#t={MOMENT_S}",
        ],
        check=True,
        capture_output=True,
    )


if __name__ == "__main__":
    main()
