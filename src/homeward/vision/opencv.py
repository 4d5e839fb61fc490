"""OpenCV, loaded at first use: it is an extra."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache
from typing import Any

from homeward.errors import needs_extra

MAX_KEPT = 256 << 20
"""Freed memory that may stay with the process [bytes]."""
MAX_BLOCK = 32 << 20
"""Larger blocks are returned to the system when freed [bytes]: the maximum of glibc."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""From glibc's malloc.h."""


def opencv() -> Any:
    """Return the module cv2.

    Raises `InputError` when it is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise needs_extra("images", "vision") from None
    _keep_memory()
    return cv2


@cache
def _keep_memory() -> None:
    """Let the C library keep freed memory for the next image.

    Otherwise SIFT's pyramids are returned to the system after each image and requested again for
    the next, which takes a third of SIFT's time. See mallopt(3); only glibc has these options.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, MAX_BLOCK)
        library.mallopt(_TRIM_THRESHOLD, MAX_KEPT)
