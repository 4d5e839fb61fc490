"""Rooms and their objects, as settings."""
