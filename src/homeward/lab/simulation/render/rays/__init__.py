"""Surfaces in space, and their intersections with rays."""
