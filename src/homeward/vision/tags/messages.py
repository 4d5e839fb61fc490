"""Tags in messages of pictures, as sightings: of a log, or of a node that listens."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.measurements.bearings import Eye, Sighting
from homeward.vision.cameras.messages import picture_of
from homeward.vision.tags.detector import TagDetector


def tag_eye(family: str) -> Eye:
    """Return what looks for the tags of a family in a sensor_msgs/Image or CompressedImage.

    Raises
    ------
    InputError
        When there is no such family; and, of what is returned, when a message is no picture, or
        has not the size that the camera was calibrated for.
    """
    detector = TagDetector(family)

    def eye(message: Any, camera: Lens | None) -> Iterator[Sighting]:
        grey = picture_of(message)
        height, width = grey.shape
        if camera is None:  # not told yet: edges are taken to be straight
            camera = Lens(fx=width, fy=width, cx=width / 2, cy=height / 2)
        camera.require_shape((height, width))
        tags = detector.find(grey, camera)
        for name, corners, sigma in zip(
            tags.names, tags.corners.tolist(), tags.sigma.tolist(), strict=True
        ):
            yield Sighting(name, 0.0, sigma=sigma, corners=tuple(map(tuple, corners)))
        for name in tags.twice:
            yield from (Sighting(name, 0.0, corners=((0.0, 0.0),) * 4),) * 2

    return eye
