"""Several optimizers with the same budget on the same drives, over many seeds."""
