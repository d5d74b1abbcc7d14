"""The paper's experiment: repeated trials, two protocols, scores on held-out drives."""
