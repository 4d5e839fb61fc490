"""The numerical heart in NumPy: the text to read; `homeward._core` is its compiled twin."""
