"""The topics of a log: what is there, which are used, and by which clock."""
