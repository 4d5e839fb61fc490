"""Panoramas to bearings: the camera front-end. It needs the extra `vision` (OpenCV 5).

>>> home, now = look(home_image, camera), look(image, camera)
>>> seen = compare(home, now, camera)
>>> seen.accepted, seen.heading, seen.homewards
"""

from homeward.vision.camera import Cylindrical, Equirectangular, Panorama
from homeward.vision.compare import Comparison, compare
from homeward.vision.features import View, look
from homeward.vision.mask import Mask

__all__ = [
    "Comparison",
    "Cylindrical",
    "Equirectangular",
    "Mask",
    "Panorama",
    "View",
    "compare",
    "look",
]
