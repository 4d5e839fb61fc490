"""Image pyramid of a panorama, sampled between pixels and across the seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.engine.native.program import address
from homeward.vision.opencv import opencv

LEVELS = 3
"""Levels of the pyramid; each has half the size of the one before."""
BLUR = 0.5
"""Standard deviation of the smoothing of the first level [px]."""
MARGIN = 64
"""The image is continued beyond its seam by so many columns on either side, at most."""


@dataclass(frozen=True)
class Pyramid:
    """A smoothed panorama at several scales."""

    levels: tuple[np.ndarray, ...]
    """float32, continued beyond the seam by `margin` columns of the first."""
    times: int
    """The first is so many times as large as the panorama."""
    width: int
    """Of the panorama [px]."""
    margin: int
    """In columns of the first level."""

    @classmethod
    def of(cls, image: np.ndarray, times: int = 1) -> Pyramid:
        """Return the picture of a grey panorama, uint8 (height, width), enlarged `times`."""
        cv2, width = opencv(), image.shape[1]
        around = min(MARGIN, width)
        wide = cv2.copyMakeBorder(image, 0, 0, around, around, cv2.BORDER_WRAP)
        wide = enlarged(wide.astype(np.float32), times)
        levels = [cv2.GaussianBlur(wide, (0, 0), BLUR)]
        for _ in range(LEVELS - 1):
            levels.append(cv2.pyrDown(levels[-1]))
        return cls(tuple(levels), times, width, around * times)

    def table(self) -> np.ndarray:
        """Return of each level address, height and width, (levels, 3) int64: for compiled code."""
        rows = [(address(grey, np.float32), *grey.shape) for grey in self.levels]
        return np.array(rows, np.int64)

    def layout(self) -> np.ndarray:
        """Return the numbers `times`, `width` and `margin`: for compiled code."""
        return np.array([self.times, self.width, self.margin], float)

    def sample(self, points: np.ndarray, spacing: np.ndarray) -> np.ndarray:
        """Return grey values between pixels.

        Parameters
        ----------
        points : ndarray, shape (n, 2, k)
            Columns and rows [px]; n patches, which may lie across the seam.
        spacing : ndarray, shape (n,)
            Between the points of each patch [px], by which the level is chosen.

        Returns
        -------
        ndarray of float32, shape (n, k)
        """
        column, row = points[:, 0], points[:, 1]
        around = np.floor((column.mean(axis=1, keepdims=True) + 0.5) / self.width) * self.width
        column = (column - around + 0.5) * self.times - 0.5 + self.margin
        row = (row + 0.5) * self.times - 0.5
        level = np.clip(np.rint(np.log2(spacing * self.times)), 0, len(self.levels) - 1).astype(int)
        grey = np.empty(column.shape, np.float32)
        for k in np.unique(level):
            rows = level == k
            x, y = (np.float32(v[rows] / 2**k) for v in (column, row))
            cv2 = opencv()
            grey[rows] = cv2.remap(
                self.levels[k], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        return grey


def enlarged(image: np.ndarray, times: int) -> np.ndarray:
    """Return an image so many times as large."""
    if times == 1:
        return image
    cv2 = opencv()
    return np.asarray(cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC))
