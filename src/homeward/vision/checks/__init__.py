"""Checks of a camera and its settings from its own pictures."""
