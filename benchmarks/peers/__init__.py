"""The same filter by others: plain NumPy, FilterPy, Stone Soup, dynamax, and C++ by hand."""
