"""SE(2) with Jacobians, and robust least squares."""
