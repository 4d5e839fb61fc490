"""The robot's motion between keyframes, from twists, and the calibration that it depends on."""
