"""Search for the filter parameters with the lowest cost: objectives, search space, optimizers and diagnostics."""
