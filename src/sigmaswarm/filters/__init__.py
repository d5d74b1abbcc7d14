"""sigmaswarm.filters."""
