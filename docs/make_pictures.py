"""Make the pictures of README and docs again: `.venv/bin/python docs/make_pictures.py`."""

from pathlib import Path

from homeward.report.canvas import png
from homeward.report.map_figure import draw_map
from homeward.studies.single_run import SAMPLE, RunSettings, prepare
from homeward.track import run

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Draw the map of the sample drive."""
    drive, estimator, _ = prepare(RunSettings(drive=SAMPLE))
    track = run(drive, estimator)
    (IMAGES / "sample-map.png").write_bytes(png(draw_map(track, drive.truth), dpi=110))


if __name__ == "__main__":
    main()
