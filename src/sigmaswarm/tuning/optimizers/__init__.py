"""sigmaswarm.tuning.optimizers."""
