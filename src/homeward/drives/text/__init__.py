"""Text that others wrote, read in bounded time and memory: tables, YAML, and settings from it."""
