"""What cannot be told: pages and drawings of observability."""
