"""Drives: the record, its folder on disk, splitting, GPS outages, time line and alignment."""
