"""Images as 8-bit grey values, and masks of pixels that show the robot itself, which are not used.

A deck, a mast or a time stamp in the picture looks the same everywhere: its matches with the home
image suggest that the robot has neither moved nor turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from homeward.errors import InputError
from homeward.vision.opencv import opencv

MIN_WIDTH, MIN_HEIGHT = 64, 16
"""Size of the smallest panorama that is accepted [px]."""
MAX_PIXELS = 64_000_000
"""Size of the largest image that is accepted [px]."""


def as_grey(image: ArrayLike) -> np.ndarray:
    """Return a picture in 8-bit grey, uint8 (height, width); not copied if it is that already.

    From integers (height, width), or (height, width, 1, 3 or 4): grey, or colour in OpenCV's order
    (BGR, or BGRA, whose alpha is ignored). 16-bit values are scaled by the smallest power of two
    that fits the brightest pixel into 8 bits. `InputError` if it is no such array, or its size is
    not that of a panorama.
    """
    if image is None:
        raise InputError("not a picture but None: check that its file exists")
    try:
        pixels = np.asarray(image)
    except ValueError:
        raise InputError("not a picture: its rows differ in length") from None
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4))):
        raise InputError(
            f"not a picture: an array of shape {pixels.shape}; give (height, width) for grey or "
            "(height, width, 3) for colour"
        )
    height, width = pixels.shape[:2]
    require_size(width, height)
    if np.issubdtype(pixels.dtype, np.floating):
        raise InputError("floating-point pixels; give 8-bit or 16-bit integers")
    if not np.issubdtype(pixels.dtype, np.integer):
        raise InputError(f"pixels of type {pixels.dtype}; give 8-bit or 16-bit integers")
    grey = np.ascontiguousarray(pixels if pixels.dtype == np.uint8 else eight_bits(pixels))
    if grey.ndim == 2:
        return grey
    if grey.shape[2] == 1:
        return grey[:, :, 0]
    cv2 = opencv()
    order = cv2.COLOR_BGR2GRAY if grey.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
    return np.asarray(cv2.cvtColor(grey, order))


def eight_bits(deep: np.ndarray) -> np.ndarray:
    """Return integers of up to 16 bits in 8 bits, scaled so that the brightest one fits.

    Raises `InputError` if they exceed 16 bits.
    """
    brightest = int(deep.max(initial=0))
    bits = max(8, brightest.bit_length())
    if deep.min(initial=0) < 0 or bits > 16:
        raise InputError("grey values exceed 16 bits; give 8 or 16 bits")
    return (deep.astype(np.int64) >> (bits - 8)).astype(np.uint8)


def require_size(width: int, height: int) -> None:
    """Raise InputError if this size [px] is too large or too small for a panorama."""
    if width * height > MAX_PIXELS:
        raise InputError(f"{width}x{height}: more than {MAX_PIXELS // 10**6} million pixels")
    if width < MIN_WIDTH or height < MIN_HEIGHT:
        least = f"{MIN_WIDTH}x{MIN_HEIGHT}"
        raise InputError(f"{width}x{height} pixels; a panorama has at least {least}")


def require_like_home(shape: tuple[int, int], home: tuple[int, int]) -> None:
    """Raise InputError if a panorama differs from home's (height, width) [px]."""
    if shape != home:
        (height, width), (home_height, home_width) = shape, home
        raise InputError(f"{width}x{height} pixels where home has {home_width}x{home_height}")


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
