"""What lasts between drives: a place's map, its homes, and what is believed to stay."""
