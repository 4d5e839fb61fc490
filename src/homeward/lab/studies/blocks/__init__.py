"""Long computations in blocks: parallel on processes or machines, resumable."""
