"""An unscented Kalman filter for planar5, step by step from the textbook's equations, in extended precision.

Nothing here is clever, nothing is shared with sigmaswarm, and nothing is the closed form: sigma points are
drawn, pushed through Newton's equations and averaged; redrawn after Q is added, and pushed through h. On x86
``numpy.longdouble`` has 64 bits of mantissa; LAPACK has none of it, so the Cholesky factor is a loop. Many
parameter sets go side by side in the leading axis.

A table of parameter sets has shape (s, 10): alpha, beta, kappa, five variances of Q, two of R.
"""

from dataclasses import dataclass

import numpy as np

Extended = np.longdouble
PI = Extended("3.14159265358979323846264338327950288")
THETA = 4
ORDER = [4, 0, 1, 2, 3]  # theta first

LOWER = np.array([1e-3, 0, 0, *[1e-5] * 5, *[1e-5] * 2])
UPPER = np.array([1, 3, 5, *[10] * 5, *[10] * 2])


def box_table(n: int, seed: int = 0) -> np.ndarray:
    """Parameter sets of the paper's box, (n, 10): 32 plain corners first, then random corners and random sets.

    A plain corner has one level for all of Q and one for all of R; at a random corner each of the ten parameters
    is at one of its bounds. Inside, alpha and the variances are uniform in their logarithms.
    """
    rng = np.random.default_rng(seed)
    corners = np.array([[a, b, k, *[q] * 5, *[r] * 2] for q in (0, 1) for r in (0, 1) for a in (0, 1)
                        for b in (0, 1) for k in (0, 1)])  # fmt: skip
    rows = list(np.where(corners == 1, UPPER, LOWER))
    while len(rows) < n:
        if len(rows) % 2:
            rows.append(np.where(rng.random(10) < 0.5, UPPER, LOWER))
        else:
            share = rng.random(10)
            row = LOWER + share * (UPPER - LOWER)
            log = [0, *range(3, 10)]
            row[log] = LOWER[log] * (UPPER[log] / LOWER[log]) ** share[log]
            rows.append(row)
    return np.array(rows[:n])


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap to [-pi, pi) without touching an angle that is inside already."""
    return angle - 2 * PI * np.floor(angle / (2 * PI) + Extended(0.5))


def cholesky(p: np.ndarray) -> np.ndarray:
    """The lower factor of (s, n, n), column by column."""
    n = p.shape[-1]
    factor = np.zeros_like(p)
    for j in range(n):
        rest = p[:, j:, j] - np.einsum("sik,sk->si", factor[:, j:, :j], factor[:, j, :j])
        factor[:, j:, j] = rest / np.sqrt(rest[:, :1])
    return factor


@dataclass(frozen=True, eq=False)
class Absorbed:
    """What the update with a fix left behind, each (s,)."""

    nis: np.ndarray
    log_determinant: np.ndarray
    squared_residual: np.ndarray


class ExtendedUkf:
    """One filter per row of the table; ``mean`` (s, 5) and ``covariance`` (s, 5, 5) are its state.

    The sigma points' headings leave f unwrapped, so their offsets from the centre need no wrapping, and none is
    done. ``wrap_offsets=True`` does it all the same: the two differ where a sigma point lies more than half a
    turn from the centre.
    """

    def __init__(self, table: np.ndarray, *, wrap_offsets: bool = False) -> None:
        self.alpha, self.beta, self.kappa = table[:, :3].astype(Extended).T
        self.q, self.r = table[:, 3:8].astype(Extended), table[:, 8:].astype(Extended)
        self.wrap_offsets = wrap_offsets
        n = 5
        self.n_plus_lambda = self.alpha**2 * (n + self.kappa)
        self.wm = np.repeat(1 / (2 * self.n_plus_lambda)[:, None], 2 * n + 1, axis=1)
        self.wc = self.wm.copy()
        self.wm[:, 0] = (self.n_plus_lambda - n) / self.n_plus_lambda
        self.wc[:, 0] = self.wm[:, 0] + 1 - self.alpha**2 + self.beta

    def restart(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        """Go on from a state, (5,) or (s, 5), (5, 5) or (s, 5, 5)."""
        s = len(self.alpha)
        self.mean = np.broadcast_to(mean, (s, 5)).astype(Extended)
        self.covariance = np.broadcast_to(covariance, (s, 5, 5)).astype(Extended)

    def _offsets(self) -> np.ndarray:
        """The sigma points as seen from the centre, (s, 11, 5)."""
        root = np.empty_like(self.covariance)
        root[:, ORDER] = cholesky(self.covariance[:, ORDER][:, :, ORDER])
        columns = np.sqrt(self.n_plus_lambda)[:, None, None] * root.swapaxes(1, 2)
        return np.concatenate([np.zeros_like(columns[:, :1]), columns, -columns], axis=1)

    def predict(self, dt: float, ax: float, ay: float, gz: float, q_scale: float) -> None:
        dt, ax, ay, gz, q_scale = (Extended(value) for value in (dt, ax, ay, gz, q_scale))
        # Positions and velocities are those in a frame that travels with the centre, where Newton's equations
        # are the same: with alpha = 1e-3 offsets are so small that 64 bits beside hundreds of metres are few.
        x, y, u, v, turn = np.moveaxis(self._offsets(), -1, 0)
        theta = self.mean[:, None, THETA] + turn
        east = np.cos(theta) * ax - np.sin(theta) * ay
        north = np.sin(theta) * ax + np.cos(theta) * ay
        sigmas = np.stack(
            [
                x + u * dt + east * dt**2 / 2,
                y + v * dt + north * dt**2 / 2,
                u + east * dt,
                v + north * dt,
                turn + gz * dt,
            ],
            axis=-1,
        )
        offsets = sigmas - sigmas[:, :1]
        if self.wrap_offsets:
            offsets[..., THETA] = wrap(offsets[..., THETA])
        shift = np.einsum("sk,ski->si", self.wm, offsets)  # the weights add up to one
        spread = offsets - shift[:, None]
        self.covariance = np.einsum("sk,ski,skj->sij", self.wc, spread, spread)
        self.covariance[:, range(5), range(5)] += q_scale * self.q
        frame = self.mean.copy()
        frame[:, :2] += self.mean[:, 2:4] * dt
        self.mean = frame + sigmas[:, 0] + shift

    def update(self, fix: np.ndarray) -> Absorbed:
        spread = self._offsets()  # h takes the first two of a point, so all means are the centre's
        s = np.einsum("sk,ski,skj->sij", self.wc, spread[..., :2], spread[..., :2])
        s[:, [0, 1], [0, 1]] += self.r
        cross = np.einsum("sk,ski,skj->sij", self.wc, spread, spread[..., :2])
        det = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] ** 2
        inverse = np.empty_like(s)
        inverse[:, 0, 0], inverse[:, 1, 1] = s[:, 1, 1] / det, s[:, 0, 0] / det
        inverse[:, 0, 1] = inverse[:, 1, 0] = -s[:, 0, 1] / det
        gain = np.einsum("sij,sjk->sik", cross, inverse)
        innovation = fix.astype(Extended) - self.mean[:, :2]
        self.mean = self.mean + np.einsum("sij,sj->si", gain, innovation)
        self.covariance = self.covariance - np.einsum("sij,sjk,slk->sil", gain, s, gain)
        return Absorbed(
            nis=np.einsum("si,sij,sj->s", innovation, inverse, innovation),
            log_determinant=np.log(det),
            squared_residual=np.sum((fix - self.mean[:, :2]) ** 2, axis=1),
        )


def mean_error(mean: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The largest difference of two means (..., 5), relative to max(1, |x_i|) of ``other``; heading wrapped."""
    difference = np.asarray(mean, dtype=Extended) - other
    difference[..., THETA] = wrap(difference[..., THETA])
    return np.max(np.abs(difference) / np.maximum(1, np.abs(other)), axis=-1).astype(float)


def covariance_error(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The largest difference of two covariances (..., 5, 5), relative to sqrt(P_ii P_jj) of ``other``."""
    std = np.sqrt(np.diagonal(other, axis1=-2, axis2=-1))
    scale = std[..., :, None] * std[..., None, :]
    difference = np.asarray(covariance, dtype=Extended) - other
    return np.max(np.abs(difference) / scale, axis=(-2, -1)).astype(float)
