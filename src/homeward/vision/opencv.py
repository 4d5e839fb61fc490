"""OpenCV, loaded when first needed: it is an extra."""

from __future__ import annotations

from typing import Any

from homeward.errors import InputError


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
    return cv2
