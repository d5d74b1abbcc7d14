"""Truth for drives that have none: the track of a good receiver in the same vehicle."""
