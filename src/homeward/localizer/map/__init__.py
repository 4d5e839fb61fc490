"""Map: keyframes and landmarks in the odometry frame, independent of home."""
