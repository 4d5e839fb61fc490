"""Sensitivity of the localiser to each of its numbers."""
