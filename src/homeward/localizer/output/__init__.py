"""What is published: the pose, its status with a reason, and the landmarks."""
