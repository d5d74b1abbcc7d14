"""sigmaswarm."""
