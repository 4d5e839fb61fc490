"""Camera models: directions of pixels, with their uncertainty, and calibration files."""
