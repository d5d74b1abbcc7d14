"""sigmaswarm.scoring."""
