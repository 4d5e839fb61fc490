"""What may be wrong with a camera or its settings, told from its own pictures."""
