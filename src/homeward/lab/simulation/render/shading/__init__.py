"""Textures, light and the sensor: from ray intersections to images."""
