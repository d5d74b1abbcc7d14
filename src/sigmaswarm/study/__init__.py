"""sigmaswarm.study: the paper's whole experiment, repeated, scored on held-out drives, and put into tables."""
