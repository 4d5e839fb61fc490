"""Drives: what enters, and its readers and writers, one format a file."""
