"""Readers of logs, one file per format: detection, tables, and the recipe of a drive."""
