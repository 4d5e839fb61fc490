"""The robust localiser: a map in the odometry frame, and home found in it."""
