"""Command line: one file per command, which parses options and prints results.

Each command imports its modules when called, so that ``--help`` is fast.
"""
