"""The batch engine on an NVIDIA GPU: one group of threads a run, compiled when it is needed."""
