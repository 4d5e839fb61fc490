"""What drives a robot, quickly: where to, within which limits, and what stops it."""
