"""Commands for panoramas."""
