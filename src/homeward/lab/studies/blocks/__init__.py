"""Long computations in blocks: spread over processes or machines, stopped and resumed."""
