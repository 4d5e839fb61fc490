"""Features: detection, matching, patch alignment, match propagation, self-similarity."""
