"""Programs: stages on named variables, and their interpreter."""
