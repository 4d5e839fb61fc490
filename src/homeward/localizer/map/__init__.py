"""Map: keyframes and landmarks in the odometry frame; knows nothing of home."""
