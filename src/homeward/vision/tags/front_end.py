"""The front-end for tags, live and from records: a picture in, bearings and deviations out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.drives.cameras.camera import Camera
from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tags import tag_bearings
from homeward.drives.drive import HomeBearing
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.tags.detector import TagDetector, Tags


@dataclass(frozen=True)
class TagBearings:
    """Bearings of tags in one picture."""

    bearings: dict[str, float]
    """Number of a tag to the bearing of its middle from the camera's axis [rad]."""
    sigmas: dict[str, float]
    """[rad]"""
    tags: Tags
    """As they lie in the picture; some may have no bearing, where the lens has no rays."""

    @property
    def home(self) -> dict[str, HomeBearing]:
        """The same as home bearings, of a picture that was taken at home."""
        return {name: HomeBearing(b, self.sigmas[name]) for name, b in self.bearings.items()}


class TagFrontEnd:
    """Turns pictures into bearings of tags.

    >>> eye = TagFrontEnd(Lens(fx=600, fy=600, cx=320, cy=240), "36h11")
    >>> seen = eye.see(picture)
    >>> localizer.bearings(t, seen.bearings, seen.sigmas)

    Parameters
    ----------
    camera : Camera
        That takes the pictures.
    family : str
        Of the tags, as for `TagDetector`.
    """

    def __init__(self, camera: Camera, family: str = "36h11") -> None:
        self.camera, self.detector = camera, TagDetector(family)

    def see(self, image: np.ndarray) -> TagBearings:
        """Look at a picture of any kind that `as_grey` takes.

        Raises
        ------
        InputError
            When it is no picture, or has not the size that the camera was calibrated for.
        """
        camera = self.camera
        grey = camera.panorama(image) if isinstance(camera, Panorama) else as_grey(image)
        shape = grey.shape[0], grey.shape[1]
        if isinstance(camera, Lens):
            camera.require_shape(shape)
        tags = self.detector.find(grey, camera)
        bearing, sigma = tag_bearings(tags.corners, tags.sigma, camera, shape)
        there = np.isfinite(bearing) & np.isfinite(sigma)
        names = [name for name, known in zip(tags.names, there, strict=True) if known]
        bearings, sigmas = (
            dict(zip(names, values[there].tolist(), strict=True)) for values in (bearing, sigma)
        )
        return TagBearings(bearings, sigmas, tags)
