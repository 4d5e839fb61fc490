"""Batches on an NVIDIA GPU: one group of threads per run, compiled at run time."""
