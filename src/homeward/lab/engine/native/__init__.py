"""Symbolic steps as compiled C: written, compiled, kept and loaded."""
