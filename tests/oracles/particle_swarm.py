"""The paper's equations 2 and 3, particle by particle and coordinate by coordinate."""

import copy

import numpy as np


def by_equations(cost, low, high, n, seed, generations, w=0.7298, c1=1.5, c2=1.5, stop_at_bounds=False):
    """Yield positions, velocities and best of each generation, in loops over particles and coordinates."""
    rng = np.random.default_rng(seed)
    d = len(low)
    x = rng.uniform(low, high, (n, d)).tolist()
    elsewhere = rng.uniform(low, high, (n, d)).tolist()
    v = [[0.5 * (elsewhere[i][j] - x[i][j]) for j in range(d)] for i in range(n)]
    p, p_cost, g = copy.deepcopy(x), [float("inf")] * n, x[0]
    for generation in range(generations):
        if generation:
            r = rng.random((2, n, d))
            for i in range(n):
                for j in range(d):
                    v[i][j] = (
                        w * v[i][j]
                        + c1 * r[0, i, j] * (p[i][j] - x[i][j])
                        + c2 * r[1, i, j] * (g[j] - x[i][j])
                    )
                    moved = x[i][j] + v[i][j]
                    x[i][j] = min(max(moved, low[j]), high[j])
                    if stop_at_bounds and x[i][j] != moved:
                        v[i][j] = 0.0
        for i in range(n):
            value = cost(np.array([x[i]]))[0]
            if value < p_cost[i]:
                p[i], p_cost[i] = list(x[i]), value
        leader = min(range(n), key=p_cost.__getitem__)
        g = list(p[leader])
        yield np.array(x), np.array(v), np.array(g), p_cost[leader]
