"""images.yaml: which camera took the panoramas, and which of them is home's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from homeward.drives.drive import Strict
from homeward.drives.images import file_within
from homeward.drives.text.settings import read_settings
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular
from homeward.vision.cameras.ring import Ring

Camera = Annotated[Equirectangular | Cylindrical | Ring, Field(discriminator="model")]
MostLandmarks = Annotated[int, Field(ge=4, le=500)]


class ImageSettings(Strict):
    """Everything that images.yaml may say; every key may be absent."""

    camera: Camera = Equirectangular()
    home: str | None = None
    """File of the home image, in the folder; None: the one whose name is home.something."""
    mask: Path | None = None
    """A picture whose black is left out, for it turns with the camera; `read_image_settings` makes
    it a path from here, of one from the folder of images.yaml."""
    landmarks: MostLandmarks = 30
    """How many landmarks at most are passed on from one image."""
    force: bool = False
    """Whether pictures are taken that look like no panoramas."""

    @model_validator(mode="before")
    @classmethod
    def _equirectangular_unless_told(cls, tree: Any) -> Any:
        if isinstance(tree, dict) and isinstance(camera := tree.get("camera"), dict):
            return {**tree, "camera": {"model": "equirectangular", **camera}}
        return tree


def read_image_settings(path: Path | None) -> ImageSettings:
    """Read images.yaml; None gives the defaults.

    Raises
    ------
    InputError
        When it has a key that is not known, a value out of range, or a mask outside its folder.
    """
    if path is None:
        return ImageSettings()
    settings = read_settings(path, ImageSettings)
    if settings.mask is None:
        return settings
    mask = file_within(path.parent, settings.mask, "mask", path)
    return settings.model_copy(update={"mask": mask})
