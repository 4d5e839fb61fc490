"""A lens that does not see all round, its pictures laid on a panorama that is black elsewhere."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal

import numpy as np

from homeward.drives.cameras.camera import Camera
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.mask import Mask
from homeward.vision.cameras.panoramic import Equirectangular
from homeward.vision.opencv import opencv

FINEST, COARSEST = 2048, 256
"""Widths of the panorama [px]."""
GRID = 33
"""So many places of a picture's columns, and of its rows, tell how high and low it sees."""
STEEPEST = math.radians(75.0)
"""Beyond this elevation a panorama stretches what it shows [rad]."""


class PartialPanorama(Equirectangular):
    """The part of a panorama that a calibrated lens sees, as if it were unwrapped.

    Everything that panoramas serve for does with it: features are bearings and elevations, and
    what the lens does not see is masked. Pixels in the picture's middle keep their size, as far as
    the panorama is not wider than it need be.
    """

    model: Literal["partial"] = "partial"  # type: ignore[assignment]
    lens: Lens
    """That takes the pictures."""

    @classmethod
    def through(cls, lens: Lens) -> PartialPanorama:
        """Return what a lens sees.

        Raises
        ------
        InputError
            When the size of its pictures is not known.
        """
        if lens.width is None or lens.height is None:
            raise InputError("in images.yaml the camera needs width and height, or tags: 36h11")
        tilt = lens.model_dump(include=set(Camera.model_fields))
        lens = lens.model_copy(update={"roll": 0.0, "pitch": 0.0})
        top, bottom = _extent(lens)
        return cls(lens=lens, horizon=top / (top - bottom), **tilt)

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the panorama, black where the lens sees nothing."""
        grey = as_grey(image)
        self.lens.require_shape((grey.shape[0], grey.shape[1]))
        black = {"borderMode": opencv().BORDER_CONSTANT, "borderValue": 0}
        return np.asarray(opencv().remap(grey, *self._map, opencv().INTER_LINEAR, **black))

    @property
    def seen(self) -> Mask | None:
        """What the lens sees."""
        assert self.lens.height is not None
        assert self.lens.width is not None
        return Mask.of(self.panorama(np.full((self.lens.height, self.lens.width), 255, np.uint8)))

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where each pixel of the panorama lies in the picture."""
        width = int(np.clip(16 * round(math.tau * self.lens.fx / 16), COARSEST, FINEST))
        top, bottom = _extent(self.lens)
        height = max(round((top - bottom) / self.column_angle(width)), 16)
        rows, columns = np.indices((height, width))
        level = self.model_copy(update={"roll": 0.0, "pitch": 0.0})
        seen = self.lens.pixels(*level.directions(columns, rows, (height, width)))
        column, row = (np.nan_to_num(part, nan=-9.0).astype(np.float32) for part in seen)
        return column, row


def _extent(lens: Lens) -> tuple[float, float]:
    """Return the greatest and the least elevation [rad] that a lens sees, and the horizon."""
    assert lens.height is not None
    assert lens.width is not None
    columns, rows = np.meshgrid(*(np.linspace(0, n - 1, GRID) for n in (lens.width, lens.height)))
    seen = lens.directions(columns.ravel(), rows.ravel())[1]
    ends = float(np.nanmax(seen)), float(np.nanmin(seen))
    return min(max(ends[0], 0.0), STEEPEST), max(min(ends[1], 0.0), -STEEPEST)
