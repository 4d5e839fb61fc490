"""Image masks: pixels that show the robot itself are not used.

A deck, a mast or a time stamp in the picture looks the same everywhere: its matches with the home
image suggest that the robot has neither moved nor turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey
from homeward.vision.opencv import opencv

MIN_USED = 128
"""Mask pixels darker than this [grey levels] exclude the pixel."""


@dataclass(frozen=True)
class Mask:
    """Usable pixels of a camera's panoramas."""

    room: np.ndarray
    """(height, width) float32: distance to the next masked pixel [px]; zero where masked."""

    @classmethod
    def of(cls, panorama: np.ndarray) -> Mask:
        """Return the mask in a picture as of `Panorama.panorama`; black (below 128) is not used.

        Raises `InputError` if it is no picture, or no pixel would be left.
        """
        used = as_grey(panorama) >= MIN_USED
        if not used.any():
            raise InputError("the mask is black everywhere: paint the usable pixels white")
        cv2, width = opencv(), used.shape[1]
        # The next masked pixel may be across the seam.
        around = np.pad(used, [(0, 0), (width // 2, width // 2)], mode="wrap").astype(np.uint8)
        room = cv2.distanceTransform(around, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return cls(room[:, width // 2 : width // 2 + width].copy())

    def clear(self, size: float) -> np.ndarray:
        """Return where patches of a diameter [px] are clear, (height, width) bool.

        Their distance from masked pixels is at least their diameter: half of it is the patch
        itself, and the other half allows for masks that are painted a little too small.
        """
        return self.room > size

    def clear_at(self, column: np.ndarray, row: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return which patches, of centres and diameters (n,) [px], are clear: (n,) bool."""
        height, width = self.room.shape
        i = np.clip(np.rint(row), 0, height - 1).astype(int)
        return np.asarray(self.room[i, np.rint(column).astype(int) % width] > size)
