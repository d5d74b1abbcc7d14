"""Extended Kalman filter of planar5 and planar8 in JAX, to train `noise-gru` with gradients.

The filter has the textbook form, with the values of `filters.constants`. It uses neither the receiver's velocity nor an
odometer. It is not reset after a divergence. With Student's t, it does not inflate P during runs of outliers. This
module needs JAX, the extra ``learned``.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.events import FIX, IMU, LATERAL, STANDSTILL, events_of
from sigmaswarm.drives.timeline import AX, AY, DT, GAP, GZ, Q_SCALE
from sigmaswarm.filters.constants import (
    GAP_ACCELERATION_STD,
    GAP_TURN_STD,
    INNOVATION_DOF,
    INNOVATION_SCALE,
    ITERATIONS,
    MOST_REJECTED,
    STANDSTILL_RATE_NOISE,
    process_noise_per_step,
)
from sigmaswarm.filters.models import GYRO_BIAS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.filters.starts import measured_by
from sigmaswarm.learned.fitting import gru
from sigmaswarm.learned.noise_gru import features_of, log_scales, nis_of

N_COLUMNS = 14
"""Number of columns of a step: dt, q_scale, gap, ax, ay, gz; flags for a fix, an IMU sample, a lateral update and a
standstill; x and y of the fix, m; stated variances of x and y, m2.
"""


def columns_of(drive_pass: FilterPass, parameters: FilterParameters) -> tuple[Array, Array]:
    """Return the steps of a pass for `run`, (k, N_COLUMNS), and their end times, (k,) s."""
    line = drive_pass.timeline
    flags = events_of(line, measured_by(parameters)).flags
    fixes = line.fixes if len(line.fixes) else np.zeros((1, 6))
    fix = fixes[np.maximum(np.cumsum(line.updates | line.hides) - 1, 0)]
    events = [(flags & bit > 0).astype(np.float64) for bit in (FIX, IMU, LATERAL, STANDSTILL)]
    moved = [line.dt, line.q_scale, line.gap, line.ax, line.ay, line.gz]
    return np.column_stack([*moved, *events, fix[:, :2], fix[:, 4:6]]), line.end


@dataclass(frozen=True, eq=False)
class FilterConstants:
    """Constants of a filter over one drive: the diagonal of Q per nominal step, (n,), and the lever arm, (2,) m."""

    q: Array
    lever: Array
    parameters: FilterParameters

    @classmethod
    def of(cls, drive_pass: FilterPass, parameters: FilterParameters) -> "FilterConstants":
        line = drive_pass.timeline
        return cls(process_noise_per_step(parameters, line.nominal_interval), line.lever[:2], parameters)


def _inverse(s: Any) -> Any:
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    return jnp.array([[s[1, 1], -s[0, 1]], [-s[1, 0], s[0, 0]]]) / det


def _update(m: Any, c: Any, h: Any, nu: Any, noise: Any, use: Any) -> tuple[Any, Any]:
    """Return the mean and covariance after a measurement. They are unchanged if ``use`` is 0."""
    s = h @ c @ h.T + noise
    gain = use * (c @ h.T) @ (1.0 / s if len(nu) == 1 else _inverse(s))
    changed = c - gain @ h @ c
    return m + gain @ nu, 0.5 * (changed + changed.T)


def _predict(q: Array, m: Any, c: Any, u: Any, scale: Any) -> tuple[Any, Any]:
    """Return the mean and covariance after a step, with ``scale`` times Q."""
    n = len(m)
    dt, gap = u[DT], u[GAP]
    cos, sin = jnp.cos(m[THETA]), jnp.sin(m[THETA])
    biased = n > GYRO_BIAS
    fx, fy = (u[AX] - m[5], u[AY] - m[6]) if biased else (u[AX], u[AY])
    rate = u[GZ] - m[GYRO_BIAS] if biased else u[GZ]
    a, b = cos * fx - sin * fy, sin * fx + cos * fy
    moved = jnp.array([m[2] * dt + a * dt**2 / 2, m[3] * dt + b * dt**2 / 2, a * dt, b * dt, rate * dt])
    f = jnp.eye(n).at[0, 2].set(dt).at[1, 3].set(dt)
    turned = jnp.array([[-b], [a]])
    jacobian = [turned, *([jnp.array([[-cos, sin], [-sin, -cos]])] if biased else [])]
    slices = [slice(THETA, THETA + 1), slice(5, 7)]
    for part_of_state, part in zip(slices, jacobian, strict=False):
        f = f.at[0:2, part_of_state].set(part * dt**2 / 2).at[2:4, part_of_state].set(part * dt)
    if biased:
        f = f.at[THETA, GYRO_BIAS].set(-dt)
    g = GAP_ACCELERATION_STD**2 * gap * dt
    unseen = jnp.zeros((n, n)).at[THETA, THETA].set(GAP_TURN_STD**2 * gap * dt)
    for i, j in ((0, 2), (1, 3)):
        unseen = unseen.at[j, j].set(g).at[i, i].set(g * dt**2 / 4)
        unseen = unseen.at[i, j].set(g * dt / 2).at[j, i].set(g * dt / 2)
    noise = jnp.diag(scale * u[Q_SCALE] * q) + unseen
    moves = dt > 0.0
    new = f @ c @ f.T + noise
    return m.at[:5].add(moved), jnp.where(moves, new, c)


def _weight(dof: float, observed: Any, noise: Any, nu: Any) -> Any:
    """Return the weight of a fix by Student's t, as in `compiled.adaptive.student_t_weight`."""
    weight = 1.0
    for _ in range(ITERATIONS):
        a = noise / weight
        g = _inverse(observed + jnp.diag(a))
        e = g @ nu
        gamma = jnp.sum(1.0 + a * (e**2 - jnp.diag(g))) / weight
        weight = (dof + 2.0) / (dof + gamma)
    return weight


def _take_fix(settings: FilterConstants, state: tuple[Any, ...], u: Any, scale: Any) -> tuple[Any, ...]:
    """Update mean, covariance and number of rejected fixes with a fix. ``scale`` is the logarithm of the factor on R.

    Also return the innovation nu (m), and xx, xy and yy of its covariance S (m2), before the update.
    """
    (m, c, rejected), p = state, settings.parameters
    cos, sin = jnp.cos(m[THETA]), jnp.sin(m[THETA])
    lx, ly = settings.lever
    arm = jnp.array([cos * lx - sin * ly, sin * lx + cos * ly])
    identity = jnp.eye(len(m))
    jacobian = identity[:2] - p.latency * identity[2:4]
    jacobian = jacobian.at[:, THETA].set(jnp.array([-arm[1], arm[0]]))
    nu = u[10:12] - (m[:2] - p.latency * m[2:4] + arm)
    noise = jnp.exp(scale) * np.array(p.measurement_noise) + (p.accuracy_scale or 0.0) * u[12:14]
    observed = jacobian @ c @ jacobian.T
    s = observed + jnp.diag(noise)
    nis = nu @ _inverse(s) @ nu
    inside = (nis <= (np.inf if p.gate is None else p.gate)) | (rejected >= MOST_REJECTED)
    rejected = jnp.where(u[6] > 0, jnp.where(inside, 0.0, rejected + 1.0), rejected)
    weight = 1.0 if p.robust_dof is None else _weight(p.robust_dof, observed, noise, nu)
    m, c = _update(m, c, jacobian, nu, jnp.diag(noise / weight), u[6] * inside)
    return m, c, rejected, jnp.array([nu[0], nu[1], s[0, 0], s[0, 1], s[1, 1]])


def _take_lateral(p: FilterParameters, m: Any, c: Any, u: Any) -> tuple[Any, Any]:
    n, cos, sin = len(m), jnp.cos(m[THETA]), jnp.sin(m[THETA])
    forward, left = cos * m[2] + sin * m[3], cos * m[3] - sin * m[2]
    row = jnp.zeros((1, n)).at[0, 2].set(-sin).at[0, 3].set(cos).at[0, THETA].set(-forward)
    rate, arm = u[GZ], p.rear_axle - p.tire_slip * (m[2] * m[2] + m[3] * m[3])
    if n > GYRO_BIAS:
        row, rate = row.at[0, GYRO_BIAS].set(arm), rate - m[GYRO_BIAS]
    return _update(m, c, row, jnp.array([arm * rate - left]), jnp.array([[p.lateral_noise]]), u[8])


def _take_standstill(noise: float, m: Any, c: Any, u: Any) -> tuple[Any, Any]:
    """Update with a velocity of 0, and with the reading of the gyro at rest, which measures the bias of the gyro."""
    identity, bias = jnp.eye(len(m)), slice(GYRO_BIAS, GYRO_BIAS + 1)
    m, c = _update(m, c, identity[2:4], -m[2:4], noise * jnp.eye(2), u[9])
    if len(m) > GYRO_BIAS:
        m, c = _update(m, c, identity[bias], u[GZ] - m[bias], jnp.array([[STANDSTILL_RATE_NOISE]]), u[9])
    return m, c


def run(settings: FilterConstants, weights: Any, mean: Any, covariance: Any, columns: Any) -> tuple[Any, Any]:
    """Run the filter with its network over k steps, from a mean (n,) and a covariance (n, n).

    Return an array (k, 6), and the means (k, n). For steps with a fix, the first five columns of the array are the
    innovation nu (m), and xx, xy and yy of its covariance S (m2), before the update. The last column is 1 at these
    steps, otherwise 0.
    """
    p, nothing = settings.parameters, jnp.array([0.0, 0.0, 1.0, 0.0, 1.0, -1.0])

    def step(state: Any, u: Any) -> Any:
        m, c, h, active, rejected, last, since = state
        m, c = _predict(settings.q, m, c, u, jnp.exp(active[1]))
        since = since + u[DT]
        m, c, rejected, innovation = _take_fix(settings, (m, c, rejected), u, active[0])
        last = jnp.where(u[6] > 0, jnp.append(innovation, since), last)
        if p.lateral_noise is not None:
            m, c = _take_lateral(p, m, c, u)
        if p.standstill_noise is not None:
            m, c = _take_standstill(p.standstill_noise, m, c, u)
        # The network reads a fix at the next IMU sample.
        reads_fix = (u[7] > 0) & (last[5] > 0.0)
        features = features_of(jnp, last[:2], last[2:5], m[THETA], jnp.maximum(last[5], 0.0))
        h = jnp.where(reads_fix, gru(jnp, weights, h, features), h)
        active = jnp.where(reads_fix, log_scales(jnp, weights, h), active)
        since = jnp.where(reads_fix, since - last[5], since)
        last = jnp.where(reads_fix, nothing, last)
        return (m, c, h, active, rejected, last, since), (jnp.append(innovation, u[6]), m)

    units = weights["hidden"].shape[0]
    start = (mean, covariance, jnp.zeros(units), jnp.zeros(2), 0.0, nothing, 0.0)
    _, (innovations, means) = jax.lax.scan(jax.checkpoint(step), start, columns)
    return innovations, means


def innovation_loss(settings: FilterConstants, innovations: Any) -> tuple[Any, Any]:
    """Return the sum of the fixes' negative log-likelihoods, nats, and the number of fixes.

    The likelihood is Student's t for a robust filter (see `constants`), otherwise Gaussian.
    """
    fixed = innovations[..., 5]
    nis, det = nis_of(innovations[..., :2], innovations[..., 2:5])
    tail = 0.5 * nis
    if settings.parameters.robust_dof is not None:
        tail = 0.5 * (INNOVATION_DOF + 2.0) * jnp.log1p(nis / INNOVATION_SCALE)
    losses = jnp.where(fixed > 0, jnp.log(2 * jnp.pi) + 0.5 * jnp.log(det) + tail, 0.0)
    return jnp.sum(losses), jnp.sum(fixed)
