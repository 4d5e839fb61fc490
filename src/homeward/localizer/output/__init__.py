"""Output: the pose in the home frame, its status with a reason, and the landmarks."""
