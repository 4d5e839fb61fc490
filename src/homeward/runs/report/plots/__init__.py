"""The plots of a run's page, which the reader can move through, and what a slider shows in them."""
