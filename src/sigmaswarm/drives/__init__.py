"""Drives: the class `Drive`, its folder on disk, splitting, GPS outages, time line and alignment."""
