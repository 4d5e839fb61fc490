"""Planning of landmarks: where homing can begin."""
