"""images.yaml: which camera took the pictures, which is home's, and what is looked for in them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.camera import Camera
from homeward.drives.cameras.lens import SAME, Lens
from homeward.drives.images import file_within
from homeward.io.keys import Strict
from homeward.io.reading import is_there
from homeward.io.settings import read_settings
from homeward.vision.cameras.panoramic import (
    Cylindrical,
    Equirectangular,
    Panorama,
    PartialPanorama,
)
from homeward.vision.cameras.ring import Ring

IMAGE_SETTINGS = "images.yaml"


class Calibrated(Camera):
    """A camera whose calibration is in a file; `read_image_settings` puts a `Lens` in its place."""

    model: Literal["calibrated"] = "calibrated"
    file: str
    """``FILE.yaml`` beside images.yaml, or ``FILE.yaml#cam1`` of several cameras."""


AnyCamera = Annotated[
    Equirectangular | Cylindrical | Ring | Lens | Calibrated, Field(discriminator="model")
]
MostLandmarks = Annotated[int, Field(ge=4, le=500)]


class ImageSettings(Strict):
    """Everything that images.yaml may say; every key may be absent."""

    camera: AnyCamera = Equirectangular()
    home: str | None = None
    """File of the home image, in the folder; None: the one whose name is home.something."""
    mask: Path | None = None
    """A picture whose black is left out, for it turns with the camera; `read_image_settings` makes
    it a path from here, of one from the folder of images.yaml."""
    landmarks: MostLandmarks = 30
    """How many landmarks at most are passed on from one image."""
    tags: str | None = None
    """Family of the tags that are looked for, such as 36h11; None: no tags, but what rooms have."""
    force: bool = False
    """Whether pictures are taken that look like no panoramas."""

    @property
    def panorama(self) -> Panorama:
        """The camera as a panoramic one.

        Raises
        ------
        InputError
            When it has a lens, and is not calibrated for pictures of one size.
        """
        if isinstance(self.camera, Panorama):
            return self.camera
        assert isinstance(self.camera, Lens)
        return PartialPanorama.through(self.camera)

    @model_validator(mode="before")
    @classmethod
    def _equirectangular_unless_told(cls, tree: Any) -> Any:
        if isinstance(tree, dict) and isinstance(camera := tree.get("camera"), dict):
            usual = "calibrated" if "file" in camera else "equirectangular"
            model = camera.get("model", usual)
            return {**tree, "camera": {**camera, "model": SAME.get(model, model)}}
        return tree


def read_image_settings(path: Path | None) -> ImageSettings:
    """Read images.yaml; None gives the defaults.

    Raises
    ------
    InputError
        When it has a key that is not known, a value out of range, or a file outside its folder.
    """
    if path is None:
        return ImageSettings()
    settings = read_settings(path, ImageSettings)
    if isinstance(camera := settings.camera, Calibrated):
        tilt = camera.model_dump(include=set(Camera.model_fields))
        lens = read_calibration(path.parent, camera.file).model_copy(update=tilt)
        settings = settings.model_copy(update={"camera": lens})

    if settings.mask is not None:
        mask = file_within(path.parent, settings.mask, "mask", path)
        settings = settings.model_copy(update={"mask": mask})
    return settings


def settings_in(folder: Path) -> ImageSettings:
    """Return the settings in images.yaml of a folder, the defaults where it has none."""
    told = folder / IMAGE_SETTINGS
    return read_image_settings(told if is_there(told) else None)
