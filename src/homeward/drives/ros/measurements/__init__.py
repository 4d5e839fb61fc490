"""Measurements out of decoded messages: odometry, bearings and home."""
