"""The gate: is the localiser as good, and as honest, as it was? See `python -m` of this package."""
