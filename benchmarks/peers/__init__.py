"""The same filter in plain NumPy, FilterPy and hand-written C++."""
