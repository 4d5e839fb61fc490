"""Peers: estimators from elsewhere, and the engine's filter with FilterPy."""
