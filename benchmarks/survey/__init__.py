"""Reflector navigation on a full survey, against peers."""
