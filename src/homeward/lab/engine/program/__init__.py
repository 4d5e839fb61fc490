"""What a filter is to the engine: its kernel, its stages, and what interprets it."""
