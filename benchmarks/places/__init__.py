"""Places: thirty days in a warehouse, and places shared between robots."""
