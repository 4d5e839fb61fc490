"""Commands for drives and runs."""
