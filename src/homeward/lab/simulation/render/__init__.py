"""Rooms that are rendered: panoramas by ray casting, their exact truth, and drives through them."""
