"""Hands results over in the forms that people use."""
