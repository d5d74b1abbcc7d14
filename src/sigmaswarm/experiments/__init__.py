"""Tuning runs with different seeds, splits or methods, and statistics of their results."""
