"""Runs and studies: what is computed, never how it is shown."""
