"""The command line: one command a file; it parses and prints, and computes nothing.

Each command imports what it needs when it is called, so that ``--help`` answers at once.
"""
