"""Make the pictures of README and docs again: `.venv/bin/python docs/make_pictures.py`."""

from pathlib import Path

from homeward.observability.study import observe
from homeward.report.canvas import png
from homeward.report.map_figure import draw_map
from homeward.report.observe_figures import draw_family
from homeward.report.plan_figures import draw_begin
from homeward.studies.planning.analysis import analyse
from homeward.studies.planning.settings import load_plan
from homeward.studies.single_run import SAMPLE, RunSettings, prepare
from homeward.track import run

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Draw the map of the sample drive, a family of homes, and the map of the example plan."""
    drive, estimator, _ = prepare(RunSettings(drive=SAMPLE))
    track = run(drive, estimator)
    (IMAGES / "sample-map.png").write_bytes(png(draw_map(track, drive.truth), dpi=110))
    (IMAGES / "observe-two.png").write_bytes(png(draw_family(observe(2)), dpi=90))
    plan = analyse(load_plan("warehouse"))
    (IMAGES / "plan-warehouse.png").write_bytes(png(draw_begin(plan), dpi=90))


if __name__ == "__main__":
    main()
