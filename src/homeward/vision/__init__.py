"""Bearings from panoramic images, and visual homing. It needs the extra `vision` (OpenCV 5).

>>> home, now = extract(home_image, camera), extract(image, camera)
>>> seen = compare(home, now, camera)
>>> seen.accepted, seen.heading, seen.home_direction
"""

from homeward.vision.cameras.grey import Mask
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular, Panorama
from homeward.vision.cameras.ring import Ring, find_ring
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import Features, extract
from homeward.vision.front_end import FrontEnd
from homeward.vision.homing.visual_homing import VisualHoming
from homeward.vision.tags.front_end import TagBearings, TagFrontEnd

__all__ = [
    "Comparison",
    "Cylindrical",
    "Equirectangular",
    "Features",
    "FrontEnd",
    "Mask",
    "Panorama",
    "Ring",
    "TagBearings",
    "TagFrontEnd",
    "VisualHoming",
    "compare",
    "extract",
    "find_ring",
]
