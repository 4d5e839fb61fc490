"""What executes a symbolic step."""
