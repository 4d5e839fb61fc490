"""Computations of studies, without their reports."""
