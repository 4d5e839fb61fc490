"""Panoramic cameras and their pictures: which direction each pixel looks in."""
