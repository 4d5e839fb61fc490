"""C programs, compiled on first use for the processor of this machine."""
