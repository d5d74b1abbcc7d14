"""Parameter sets within the bounds of a search, defined independently: corners, and random sets."""

from dataclasses import replace

import numpy as np

from sigmaswarm.filters.parameters import FilterParameters

# Bounds of the paper: alpha, beta, kappa, five variances of Q, two of R.
LOWER = np.array([1e-3, 0, 0, *[1e-5] * 5, *[1e-5] * 2])
UPPER = np.array([1, 3, 5, *[10] * 5, *[10] * 2])

# Bounds of the other parameters: bias_std (2), velocity_noise, lateral_noise, rear_axle, tire_slip, standstill_noise,
# gate, latency and forgetting.
_MORE = np.array([
    [1e-3, 1], [1e-5, 0.1], [1e-4, 10], [1e-4, 10], [-1, 4], [0, 0.02], [1e-6, 1], [4, 100], [0, 0.5], [0.9, 0.9999]
]).T  # fmt: skip


def box_table(n: int, seed: int = 0) -> np.ndarray:
    """Return parameter sets within the paper's bounds, (n, 10): 32 plain corners, then random corners and random sets.

    A plain corner has one level for all of Q and one for all of R; at a random corner, each of the ten parameters is
    at one of its bounds. Random sets are uniform in the logarithms of alpha and the variances.
    """
    rng = np.random.default_rng(seed)
    corners = np.array([[a, b, k, *[q] * 5, *[r] * 2] for q in (0, 1) for r in (0, 1) for a in (0, 1)
                        for b in (0, 1) for k in (0, 1)])  # fmt: skip
    rows = list(np.where(corners == 1, UPPER, LOWER))
    while len(rows) < n:
        rows.append(_draw(rng, LOWER, UPPER, corner=len(rows) % 2 == 1))
    return np.array(rows[:n])


def _draw(rng: np.random.Generator, lower: np.ndarray, upper: np.ndarray, *, corner: bool) -> np.ndarray:
    """Draw a random corner or a random row, which is uniform, in the logarithm if the lower bound is positive."""
    if corner:
        return np.where(rng.random(len(lower)) < 0.5, upper, lower)
    share = rng.random(len(lower))
    row = lower + share * (upper - lower)
    log = lower > 0
    row[log] = lower[log] * (upper[log] / lower[log]) ** share[log]
    return row


def as_parameters(table: np.ndarray, **more) -> list[FilterParameters]:
    """Convert the rows of a `box_table` to the library's records."""
    return [FilterParameters(*map(float, row[:3]), tuple(row[3:8]), tuple(row[8:]), **more) for row in table]


def box_sets(model: str, kind: str, n: int, seed: int = 0) -> list[FilterParameters]:
    """Return sets within a model's bounds that use every measurement: random sets and corners in turn."""
    rng = np.random.default_rng(seed)
    low, states = LOWER, 5
    high = UPPER
    if model == "planar8":
        states = 8
        low = np.array([*LOWER[:3], *[1e-12] * 5, *[1e-16] * 3, *LOWER[8:]])
        high = np.array([*UPPER[:8], *[1e-4] * 3, *UPPER[8:]])
    if model == "tilted12":
        states, position = 12, [1e-12] * 2
        low = np.array(
            [*LOWER[:3], *position, *[1e-7] * 2, *[1e-12] * 3, 1e-16, *[1e-12] * 2, *[1e-16] * 2, *LOWER[8:]]
        )
        walks = [1e-3, 1e-3, 1e-3, 1e-6, 1e-4, 1e-4, 1e-6, 1e-6]  # from theta on
        high = np.array([*UPPER[:3], 10.0, 10.0, 1.0, 1.0, *walks, *UPPER[8:]])
    low, high = np.concatenate([low, _MORE[0]]), np.concatenate([high, _MORE[1]])
    sets = [_equipped(_draw(rng, low, high, corner=i % 2 == 1), states, model, kind) for i in range(n)]
    return _ruled(sets, rng) if kind == "fuzzy-ukf" else sets


def _ruled(sets: list[FilterParameters], rng: np.random.Generator) -> list[FilterParameters]:
    """Add the memory, widths and gains of a fuzzy filter to the sets."""
    memory, widths = rng.uniform(0.5, 0.999, len(sets)), 10.0 ** rng.uniform(-1, 0, (len(sets), 2))
    gains = 100.0 ** rng.uniform(0, 1, (len(sets), 2))
    each = zip(sets, memory.tolist(), map(tuple, widths.tolist()), map(tuple, gains.tolist()), strict=True)
    return [replace(p, forgetting=m, fuzzy_widths=w, fuzzy_gains=g) for p, m, w, g in each]


def weighed(sets: list[FilterParameters], seed: int = 0) -> list[FilterParameters]:
    """Replace the gate of the sets with Student's t and stated accuracies."""
    rng = np.random.default_rng(seed)
    scale, dof = 10.0 ** rng.uniform(-3, 1, len(sets)), 30.0 ** rng.uniform(0, 1, len(sets))
    each = zip(sets, scale.tolist(), dof.tolist(), strict=True)
    return [replace(p, gate=None, accuracy_scale=s, robust_dof=d) for p, s, d in each]


def wheeled(sets: list[FilterParameters], seed: int = 0) -> list[FilterParameters]:
    """Add an odometer to the sets: noise, scale and latency."""
    rng = np.random.default_rng(seed)
    noise, scale = 10.0 ** rng.uniform(-4, 1, len(sets)), rng.uniform(0.9, 1.1, len(sets))
    each = zip(sets, noise.tolist(), scale.tolist(), rng.uniform(0.0, 0.3, len(sets)).tolist(), strict=True)
    return [replace(p, odometer_noise=n, odometer_scale=s, odometer_latency=d) for p, n, s, d in each]


def _equipped(row: np.ndarray, states: int, model: str, kind: str) -> FilterParameters:
    values = row.tolist()
    q, r, more = values[3 : 3 + states], values[3 + states : 5 + states], values[5 + states :]
    names = (
        "velocity_noise",
        "lateral_noise",
        "rear_axle",
        "tire_slip",
        "standstill_noise",
        "gate",
        "latency",
        "forgetting",
    )
    options = dict(zip(names, more[2:], strict=True))
    return FilterParameters(
        *values[:3], tuple(q), tuple(r), model, kind=kind, bias_std=(more[0], more[1]), **options
    )
