"""Odometry: the clock of a drive, the history of its twists, and dead reckoning."""
