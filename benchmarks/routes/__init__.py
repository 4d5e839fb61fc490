"""Routes: taught once, and driven again after goods were moved."""
