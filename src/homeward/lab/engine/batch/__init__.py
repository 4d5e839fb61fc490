"""Batches: many runs of the same program at once, in lanes and threads."""
