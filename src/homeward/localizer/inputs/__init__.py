"""What arrives, in which order, and how noisy it is."""
