"""Planning of landmarks: where homing can begin, and which landmarks to add."""
