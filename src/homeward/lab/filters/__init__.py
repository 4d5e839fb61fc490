"""The paper's three filters as symbolic steps, one estimator a file."""
