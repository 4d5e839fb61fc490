"""Paired comparisons: two variants of the localiser on the same drives."""
