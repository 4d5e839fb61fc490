"""The four simulated cases of the paper, with options for unspecified parameters."""
