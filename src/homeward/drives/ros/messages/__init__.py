"""Messages: their definitions, their decoding, and their stamps."""
