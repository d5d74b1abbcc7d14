"""Compute truth for drives from a good receiver in the same vehicle."""
