"""OpenCV, loaded when first needed: it is an extra."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache
from typing import Any

from homeward.errors import needs_extra

KEPT = 256 << 20
"""So much freed memory may stay with the process [bytes]."""
MAX_BLOCK = 32 << 20
"""Larger blocks come from the system and go back to it [bytes]: the most that glibc allows."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""In glibc's malloc.h."""


def opencv() -> Any:
    """Return the module cv2.

    Raises
    ------
    InputError
        When it is not installed.
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

    SIFT's pyramids were given back to the system after every image and taken again, page by page,
    for the next one: a third of SIFT's time. See mallopt(3); other C libraries do as they do.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, MAX_BLOCK)
        library.mallopt(_TRIM_THRESHOLD, KEPT)
