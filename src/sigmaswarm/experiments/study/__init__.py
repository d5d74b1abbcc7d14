"""The paper's whole experiment: repeated trials, two protocols, scores on held-out drives."""
