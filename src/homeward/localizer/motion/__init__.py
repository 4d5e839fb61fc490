"""Motion model: preintegrated odometry, its noise and its calibration."""
