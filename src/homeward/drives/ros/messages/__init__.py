"""Definitions, decoding and stamps of messages."""
