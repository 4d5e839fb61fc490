"""Conversion of images of any kind to 8 bits of grey."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from homeward.errors import InputError
from homeward.vision.opencv import opencv

NARROWEST, LOWEST = 64, 16
"""Size of the smallest panorama that is accepted [px]."""
MAX_PIXELS = 64_000_000
"""Size of the largest image that is accepted [px]."""


def as_grey(image: ArrayLike) -> np.ndarray:
    """Return a picture in 8 bits of grey; one that is so already, as it is.

    Parameters
    ----------
    image : array of integers, shape (height, width), or (height, width, 1, 3 or 4)
        Grey, or colour in OpenCV's order (BGR, or BGRA, whose alpha is left out), of 8 bits, or of
        16: these are scaled by the power of two that holds the brightest pixel.

    Returns
    -------
    ndarray of uint8, shape (height, width)

    Raises
    ------
    InputError
        When it is no such array, or of a size that is no panorama's.
    """
    if image is None:
        raise InputError("no picture, but None: was its file there?")
    try:
        pixels = np.asarray(image)
    except ValueError:
        raise InputError("no picture: its rows are of different lengths") from None
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4))):
        raise InputError(
            f"an array of shape {pixels.shape} is no picture: that is (height, width) of grey, or "
            "(height, width, 3) of colour"
        )
    height, width = pixels.shape[:2]
    require_size(width, height)
    if np.issubdtype(pixels.dtype, np.floating):
        raise InputError("floating-point pixels; give 8 or 16 bits")
    if not np.issubdtype(pixels.dtype, np.integer):
        raise InputError(f"pixels of type {pixels.dtype}; give 8 or 16 bits")
    grey = np.ascontiguousarray(pixels if pixels.dtype == np.uint8 else eight_bits(pixels))
    if grey.ndim == 2:
        return grey
    if grey.shape[2] == 1:
        return grey[:, :, 0]
    cv2 = opencv()
    order = cv2.COLOR_BGR2GRAY if grey.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
    return np.asarray(cv2.cvtColor(grey, order))


def eight_bits(deep: np.ndarray) -> np.ndarray:
    """Return whole numbers of up to 16 bits in 8: scaled by the bits that the brightest one needs.

    Raises
    ------
    InputError
        When they are beyond 16 bits.
    """
    brightest = int(deep.max(initial=0))
    bits = max(8, brightest.bit_length())
    if deep.min(initial=0) < 0 or bits > 16:
        raise InputError("grey values beyond 16 bits")
    return (deep.astype(np.int64) >> (bits - 8)).astype(np.uint8)


def require_size(width: int, height: int) -> None:
    """Raise InputError when a picture of so many columns and rows is no panorama."""
    if width * height > MAX_PIXELS:
        raise InputError(f"{width}x{height}: more than {MAX_PIXELS // 10**6} million pixels")
    if width < NARROWEST or height < LOWEST:
        raise InputError(f"{width}x{height} pixels; a panorama has at least {NARROWEST}x{LOWEST}")


def require_like_home(shape: tuple[int, int], home: tuple[int, int]) -> None:
    """Raise InputError when a panorama has not home's (height, width) [px]."""
    if shape != home:
        (height, width), (home_height, home_width) = shape, home
        raise InputError(f"{width}x{height} pixels where home has {home_width}x{home_height}")
