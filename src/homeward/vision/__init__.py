"""Bearings from panoramic images, and visual homing. It needs the extra `vision` (OpenCV 5).

>>> home, now = look(home_image, camera), look(image, camera)
>>> seen = compare(home, now, camera)
>>> seen.accepted, seen.heading, seen.homewards
"""

from homeward.vision.cameras.mask import Mask
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular, Panorama
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import View, look

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
