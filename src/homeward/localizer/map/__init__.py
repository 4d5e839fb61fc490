"""The map in the odometry frame, by fixed-lag smoothing; it knows nothing of home."""
