"""The room and what is in it, as settings."""
