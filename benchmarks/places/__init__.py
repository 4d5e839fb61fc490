"""Places that last: thirty days in a warehouse, and what robots make of each other's places."""
