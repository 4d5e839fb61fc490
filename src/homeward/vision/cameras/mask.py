"""Image masks: pixels that show the robot itself are left out.

A deck, a mast or a time stamp in the picture looks the same wherever the robot stands: matched with
itself at home, it says that the robot has neither moved nor turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey
from homeward.vision.opencv import opencv

HALF = 128
"""Pixels darker than this are left out."""


@dataclass(frozen=True)
class Mask:
    """Which pixels of a camera's panoramas may be used."""

    room: np.ndarray
    """(height, width) float32: distance to the next masked pixel [px]; zero where masked."""

    @classmethod
    def of(cls, panorama: np.ndarray) -> Mask:
        """Return the mask that a picture is of.

        Parameters
        ----------
        panorama : ndarray
            As `Panorama.panorama` gives it, of any kind that `as_grey` takes;
            black (below 128) is left out.

        Raises
        ------
        InputError
            When it is no picture, or nothing would be left.
        """
        used = as_grey(panorama) >= HALF
        if not used.any():
            raise InputError("black all over: in a mask, white is what is used")
        cv2, width = opencv(), used.shape[1]
        # Across the seam, too, what is left out may be near.
        around = np.pad(used, [(0, 0), (width // 2, width // 2)], mode="wrap").astype(np.uint8)
        room = cv2.distanceTransform(around, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return cls(room[:, width // 2 : width // 2 + width].copy())

    def clear(self, size: float) -> np.ndarray:
        """Return where patches of a diameter [px] are clear, (height, width) bool.

        They stand off masked pixels by a diameter: half of one holds the patch itself; as much
        again allows for masks that are painted a little too small.
        """
        return self.room > size

    def clear_at(self, column: np.ndarray, row: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return which patches are clear of what is left out, (n,) bool.

        Parameters
        ----------
        column, row : ndarray, shape (n,)
            Their centres [px].
        size : ndarray, shape (n,)
            Their diameters [px].
        """
        height, width = self.room.shape
        i = np.clip(np.rint(row), 0, height - 1).astype(int)
        return np.asarray(self.room[i, np.rint(column).astype(int) % width] > size)
