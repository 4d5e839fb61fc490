"""Make the pictures of docs/reproduction.md again: `.venv/bin/python docs/make_study_pictures.py`.

The studies are computed in out/, or continued from there: 45
minutes of a processor for the paper's layouts, and ten minutes for the two tuning studies.
"""

import argparse
from pathlib import Path

from homeward.lab.report.paper.layout_page import FIGURES
from homeward.lab.report.study.maps import draw_maps, grids
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.blocks.store import store_of
from homeward.lab.studies.paper.layouts import LayoutSettings, open_store
from homeward.lab.studies.paper.reproduction import study_layouts
from homeward.lab.studies.study.plan import load_study, make_plan
from homeward.lab.studies.study.results import run_study
from homeward.runs.report.canvas import png

IMAGES = Path(__file__).parent / "images"
DPI = 110


def layouts(out: Path) -> None:
    """Draw the figures of `homeward study layouts`."""
    study = study_layouts(LayoutSettings(), StudyBlocks(open_store(out / "paper-study")))
    for name, (_, draw) in FIGURES.items():
        keep(f"layouts-{name}", draw(study))


def tuning(name: str, out: Path) -> None:
    """Draw the map of a tuning study."""
    plan = make_plan(load_study(name))
    results = run_study(plan, StudyBlocks(store_of(plan.study, out / name)))
    for grid in grids(results):
        keep(name, draw_maps(results, grid))


def keep(name: str, figure) -> None:
    """Write a figure into the docs."""
    (IMAGES / f"{name}.png").write_bytes(png(figure, dpi=DPI))


def main() -> None:
    """Complete the studies, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"), help="where studies are kept")
    out = parser.parse_args().out
    layouts(out)
    tuning("a-ekf-tuning", out)
    tuning("pi-ekf-tuning", out)


if __name__ == "__main__":
    main()
