"""The same filter in plain NumPy, FilterPy, Stone Soup, dynamax, JAX and hand-written C++."""
