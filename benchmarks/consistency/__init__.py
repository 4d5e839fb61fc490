"""The consistency gate: accuracy and consistency of the localiser against a baseline."""
