"""Routes: taught once, and repeated after landmarks were moved."""
