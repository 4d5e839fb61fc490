"""Sensor inputs: the order of samples, their noise, and their sign convention."""
