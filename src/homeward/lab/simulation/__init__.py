"""Worlds, faults, visibility, and the closed loop."""
