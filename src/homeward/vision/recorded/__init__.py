"""Folders of panoramas, recorded along a drive."""
