"""Drives: the class `Drive`, its folder on disk, splitting, GPS outages, timeline and alignment."""
