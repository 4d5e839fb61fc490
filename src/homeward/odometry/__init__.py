"""Odometry: clock, history of twists, dead reckoning, and limits of motion."""
