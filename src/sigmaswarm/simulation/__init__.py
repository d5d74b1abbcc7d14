"""sigmaswarm.simulation."""
