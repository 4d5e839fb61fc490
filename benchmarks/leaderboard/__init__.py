"""All estimators on the same drives, simulated and real. See `python -m` of this package."""
