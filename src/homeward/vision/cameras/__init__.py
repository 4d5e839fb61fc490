"""Panoramic cameras: the direction of each pixel; image files and masks."""
