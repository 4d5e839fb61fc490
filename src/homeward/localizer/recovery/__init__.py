"""Whether the robot is where the map says, and where it is if not."""
