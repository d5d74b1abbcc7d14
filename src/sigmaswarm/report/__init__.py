"""sigmaswarm.report."""
