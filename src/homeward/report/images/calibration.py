"""A calibration as files: the camera as ROS writes it, and a picture of its residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from matplotlib.figure import Figure

from homeward.drives.cameras.lens import Lens
from homeward.report.canvas import WIDTH_IN, new_figure, png, style
from homeward.report.output import whole_folder
from homeward.report.palette import BLUE, MUTED
from homeward.report.words import count
from homeward.vision.calibrating import Calibration

CAMERA, RESIDUALS = "camera.yaml", "residuals.png"
LONG = 0.05
"""The root mean square of the residuals is drawn so long, as a share of the picture's width."""


def describe_calibration(found: Calibration) -> str:
    """Say how well the lens explains the pictures."""
    lens, width = found.lens, found.lens.width or 0
    across = lens.directions(np.array([0.0, width - 1.0]), np.full(2, lens.cy))[0]
    wide = (
        f"{np.degrees(across[0] - across[1]):.1f} deg across" if np.isfinite(across).all() else ""
    )
    text = (
        f"{lens.model} from {count(len(found.used), 'picture')}: residuals {found.rms:.3f} px "
        f"({np.degrees(found.rms / lens.fx):.4f} deg), focal length {lens.fx:.2f} px"
    )
    if found.unused:
        text += f"; {count(len(found.unused), 'picture')} without the board"
    return ", ".join(filter(None, (text, wide))) + "."


def write_calibration(found: Calibration, folder: Path) -> None:
    """Write camera.yaml and residuals.png, both or none."""
    with whole_folder(folder, CAMERA) as scratch:
        text = yaml.safe_dump(_camera_info(found.lens), sort_keys=False, default_flow_style=None)
        (scratch / CAMERA).write_text(text, encoding="utf-8")
        with style():
            (scratch / RESIDUALS).write_bytes(png(_picture(found)))


def _camera_info(lens: Lens) -> dict[str, object]:
    """Return what camera_info of ROS has; the first pixel's middle is (0, 0)."""

    def matrix(rows: int, data: list[float]) -> dict[str, object]:
        return {"rows": rows, "cols": len(data) // rows, "data": data}

    k = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
    return {
        "image_width": lens.width,
        "image_height": lens.height,
        "camera_name": "camera",
        "camera_matrix": matrix(3, k),
        "distortion_model": lens.model,
        "distortion_coefficients": matrix(1, list(lens.distortion)),
        "rectification_matrix": matrix(3, [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]),
        "projection_matrix": matrix(3, [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]),
    }


def _picture(found: Calibration) -> Figure:
    """Draw where corners lay, and how far the model is off there."""
    width, height = found.lens.width or 1, found.lens.height or 1
    figure = new_figure(WIDTH_IN * height / width + 0.6)
    axes = figure.add_subplot()
    axes.quiver(
        *found.points.T,
        *found.residuals.T,
        color=BLUE,
        angles="xy",
        scale_units="xy",
        scale=found.rms / (LONG * width),
        width=0.0015,
    )
    axes.plot([found.lens.cx], [found.lens.cy], "+", color=MUTED)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set_xlabel(
        f"column [px]; residuals are drawn {LONG * width / found.rms:.0f} times as long: their "
        f"root mean square is {found.rms:.3f} px"
    )
    axes.set_ylabel("row [px]")
    return figure
