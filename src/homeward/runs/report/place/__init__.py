"""What is left behind of a place: words, and a page of its visits."""
