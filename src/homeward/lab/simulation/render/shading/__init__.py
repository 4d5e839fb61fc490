"""Textures, light and the sensor: from what rays meet to a picture."""
