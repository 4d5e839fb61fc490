"""Two-view geometry: the motion between two panoramas, from directions alone."""
