"""Settings in images.yaml: camera, home image, mask, landmarks or tags."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.camera import Camera, TagSize
from homeward.drives.cameras.lens import SYNONYMS, Lens
from homeward.drives.images import file_within
from homeward.io.checks import Field
from homeward.io.models import Strict, model_validator
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
    """A camera whose calibration is in a file; `read_image_settings` replaces it by a `Lens`."""

    model: Literal["calibrated"] = "calibrated"
    file: str
    """``FILE`` next to images.yaml, or ``FILE#cam1`` for one of several cameras."""


AnyCamera = Annotated[
    Equirectangular | Cylindrical | Ring | Lens | Calibrated, Field(discriminator="model")
]
MaxLandmarks = Annotated[int, Field(ge=4, le=500)]


class ImageSettings(Strict):
    """Contents of images.yaml; every key is optional."""

    camera: AnyCamera = Equirectangular()
    home: str | None = None
    """File of the home image, in the folder; None: the one named home, with any ending."""
    mask: Path | None = None
    """A picture whose black pixels are not used, since they show the robot. A path in the file is
    relative to its folder; `read_image_settings` makes it relative to the working directory."""
    landmarks: MaxLandmarks = 30
    """Maximum number of landmarks that are passed on from one image."""
    tags: str | None = None
    """Family of the tags to detect, such as 36h11; None: natural features instead of tags."""
    tag_size: TagSize | None = None
    """Length of the sides of tags [m], of all or by id, for ranges; None: no ranges. For tags on
    vertical surfaces."""
    force: bool = False
    """Whether to accept pictures that do not look like panoramas."""

    @property
    def panorama(self) -> Panorama:
        """The camera as a panoramic one.

        Raises `InputError` if it has a lens whose calibration lacks the size of the pictures.
        """
        if isinstance(self.camera, Panorama):
            return self.camera
        assert isinstance(self.camera, Lens)
        return PartialPanorama.through(self.camera)

    @model_validator(mode="before")
    @classmethod
    def _equirectangular_by_default(cls, tree: Any) -> Any:
        if isinstance(tree, dict) and isinstance(camera := tree.get("camera"), dict):
            default = "calibrated" if "file" in camera else "equirectangular"
            model = camera.get("model", default)
            return {**tree, "camera": {**camera, "model": SYNONYMS.get(model, model)}}
        return tree


def read_image_settings(path: Path | None) -> ImageSettings:
    """Read images.yaml; None gives the defaults.

    Raises `InputError` if it has an unknown key, a value out of range, or a file outside its
    folder.
    """
    if path is None:
        return ImageSettings()
    settings = read_settings(path, ImageSettings)
    if isinstance(camera := settings.camera, Calibrated):
        tilt = camera.model_dump(include=set(Camera.model_fields), exclude_unset=True)
        lens = read_calibration(path.parent, camera.file).model_copy(update=tilt)
        settings = settings.model_copy(update={"camera": lens})
    if settings.mask is not None:
        mask = file_within(path.parent, settings.mask, "mask", path)
        settings = settings.model_copy(update={"mask": mask})
    return settings


def settings_in(folder: Path) -> ImageSettings:
    """Return the settings in images.yaml of a folder; the defaults if there is no such file."""
    path = folder / IMAGE_SETTINGS
    return read_image_settings(path if is_there(path) else None)
