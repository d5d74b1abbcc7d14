"""sigmaswarm.experiments: many tunings over seeds, splits and methods, and the statistics of what they found."""
