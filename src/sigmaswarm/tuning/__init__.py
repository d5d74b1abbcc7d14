"""sigmaswarm.tuning."""
