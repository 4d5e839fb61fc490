"""Before a robot drives: whether a place is good enough to come home in, and what helps."""
