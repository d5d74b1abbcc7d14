"""sigmaswarm.experiments: tunings over seeds, splits and methods, and statistics of their results."""
