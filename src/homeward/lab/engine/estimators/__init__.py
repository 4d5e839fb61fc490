"""Filters that run one drive: the online estimators of the library."""
