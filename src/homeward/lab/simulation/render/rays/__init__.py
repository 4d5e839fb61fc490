"""Surfaces in space, and what rays meet there."""
