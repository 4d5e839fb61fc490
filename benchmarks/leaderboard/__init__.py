"""All estimators on the same drives, simulated and real."""
