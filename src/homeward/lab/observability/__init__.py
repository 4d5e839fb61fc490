"""Observability from bearings: ranks, null spaces, and their meaning in words."""
