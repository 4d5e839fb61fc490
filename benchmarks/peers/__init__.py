"""The same filter in plain NumPy, FilterPy, Stone Soup, dynamax and hand-written C++."""
