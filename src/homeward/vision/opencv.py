"""OpenCV, loaded when first needed: it is an extra."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from homeward.errors import InputError

KEPT = 31 << 20
"""Of memory [bytes]: just below the largest block by which the C library adapts itself."""


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
        raise InputError("images need OpenCV: pip install 'homeward[vision]'") from None
    _keep_memory()
    return cv2


@cache
def _keep_memory() -> None:
    """Let the C library keep freed memory for the next image.

    SIFT's pyramids are given back to the system after every image and taken again, page by page,
    for the next one, which was a third of SIFT's time. glibc keeps twice the size of the largest
    block that it has seen freed (mallopt(3), M_MMAP_THRESHOLD); elsewhere this does nothing.
    """
    np.empty(KEPT, np.uint8)
