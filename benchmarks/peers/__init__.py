"""The same filter in plain NumPy, FilterPy, dynamax and hand-written C++."""
