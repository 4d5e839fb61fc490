"""Tags in pictures of ROS messages, as sightings: from a log, or in a node."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.measurements.sightings import Sighting, TagDetector
from homeward.errors import InputError
from homeward.io.table import quoted
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.image_files import decoded_grey
from homeward.vision.opencv import opencv
from homeward.vision.tags.front_end import TagFrontEnd

PLAIN = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1, None)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1, None)),
    **dict.fromkeys(("bgr8", "8UC3"), ("u1", 3, None)),
    "bgra8": ("u1", 4, None),
    "rgb8": ("u1", 3, "COLOR_RGB2GRAY"),
    "rgba8": ("u1", 4, "COLOR_RGBA2GRAY"),
    **dict.fromkeys(("yuv422", "uyvy"), ("u1", 2, "COLOR_YUV2GRAY_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), ("u1", 2, "COLOR_YUV2GRAY_YUY2")),
    # ROS names a Bayer pattern by its first two pixels, OpenCV by the second ones of its rows.
    "bayer_rggb8": ("u1", 1, "COLOR_BayerBG2GRAY"),
    "bayer_bggr8": ("u1", 1, "COLOR_BayerRG2GRAY"),
    "bayer_gbrg8": ("u1", 1, "COLOR_BayerGR2GRAY"),
    "bayer_grbg8": ("u1", 1, "COLOR_BayerGB2GRAY"),
}
"""Encoding (sensor_msgs/image_encodings.h): number type, numbers per pixel, conversion to grey."""


def picture_of(message: Any) -> np.ndarray:
    """Return the picture of a decoded message, uint8 (height, width).

    Raises `InputError` if its encoding is unknown, or its bytes are no picture.
    """
    if not hasattr(message, "encoding"):
        return decoded_grey(io.BytesIO(bytes(message.data)), Path(message.format or "picture"))
    if message.encoding not in PLAIN:
        raise InputError(f"a picture with unknown encoding {quoted(message.encoding)}")
    kind, channels, grey = PLAIN[message.encoding]
    numbers = np.dtype((">" if message.is_bigendian else "<") + kind)
    height, width, step = message.height, message.width, message.step
    line = width * channels * numbers.itemsize
    if not (height and width and step >= line and len(message.data) >= step * (height - 1) + line):
        raise InputError(f"a picture of {width}x{height} {message.encoding} lacks some pixels")
    raw = np.frombuffer(bytes(message.data), np.uint8)
    rows = np.lib.stride_tricks.as_strided(raw, (height, line), (step, 1))
    pixels = np.ascontiguousarray(rows).view(numbers).reshape(height, width, channels)
    if grey is None:
        return as_grey(pixels)
    cv2 = opencv()
    return np.asarray(cv2.cvtColor(pixels if channels > 1 else pixels[..., 0], getattr(cv2, grey)))


def tag_eye(family: str) -> TagDetector:
    """Return a function that detects tags in a sensor_msgs/Image or CompressedImage.

    Raises `InputError` if there is no such family. The function raises it if a message is no
    picture, or its size differs from that of the camera's calibration.
    """
    front_end = TagFrontEnd(None, family)

    def eye(message: Any, camera: Lens | None) -> Iterator[Sighting]:
        tags = front_end.tags(picture_of(message), camera)
        corners = tags.corners.reshape(-1, 8).tolist()
        for name, values, sigma in zip(tags.names, corners, tags.sigma.tolist(), strict=True):
            yield Sighting(name, tuple(values), sigma)
        for name in tags.twice:
            yield from (Sighting(name, (0.0,) * 8),) * 2

    return eye
