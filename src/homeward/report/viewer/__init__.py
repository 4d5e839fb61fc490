"""A run in Rerun's viewer."""
