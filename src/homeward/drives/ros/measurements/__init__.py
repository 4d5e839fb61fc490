"""Odometry, bearings and camera extrinsics from decoded messages."""
