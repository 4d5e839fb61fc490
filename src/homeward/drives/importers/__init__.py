"""Drives from CSV files of any columns, separators and units: guessed, told, and checked."""
