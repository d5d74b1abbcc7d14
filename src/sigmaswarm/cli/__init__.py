"""sigmaswarm.cli."""
