"""Camera models: which direction each pixel looks in, and how surely."""
