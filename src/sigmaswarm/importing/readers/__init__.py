"""Readers of logs, one file per format: each detects its format, reads the tables, and guesses a recipe."""
