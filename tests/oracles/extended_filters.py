"""Every filter type for a car, from the textbook's equations, in extended precision.

The code shares nothing with sigmaswarm's filters, and uses no closed forms: sigma points are drawn, propagated by
Newton's equations and averaged; they are drawn again after Q is added and after each measurement, and transformed by h.
The extended filter has manual Jacobians and Joseph's form of the update. The leading axis of all arrays is that of the
s parameter sets.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oracles import extended_car
from oracles.extended import Extended, cholesky, diagonal, transposed, whiten
from oracles.extended_car import Measurement, coasted, newton, newton_jacobian
from sigmaswarm.drives.events import FIX, LATERAL, ODOMETER, STANDSTILL, VELOCITY
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.parameters import FilterParameters

GYRO_AT_REST = (
    Extended("0.5") * Extended("3.14159265358979323846264338327950288") / 180
) ** 2  # (0.5 deg/s)^2
MOST_REJECTED = 5
SLIPS = 9
GAP_TURN, GAP_TILT, GAP_ACCELERATION = Extended("0.1"), Extended("0.01"), Extended(1)  # rad/s, rad/s, m/s2


@dataclass
class Innovation:
    """nu (s, m), S (s, m, m), C (s, n, m), R (s, m, m)."""

    nu: np.ndarray
    s: np.ndarray
    c: np.ndarray
    r: np.ndarray


class SigmaPointForm:
    """Merwe's scaled sigma points, (s, 2n + 1) of them, from the Cholesky factor with theta first."""

    def __init__(self, sets: Sequence[FilterParameters]) -> None:
        alpha, beta, kappa = np.array([[p.alpha, p.beta, p.kappa] for p in sets], dtype=Extended).T
        n = sets[0].n_states
        self.order = [4, 0, 1, 2, 3, 5, 6, 7][:n]
        self.n_plus_lambda = alpha**2 * (n + kappa)
        self.wm = np.repeat(1 / (2 * self.n_plus_lambda)[:, None], 2 * n + 1, axis=1)
        self.wc = self.wm.copy()
        self.wm[:, 0] = (self.n_plus_lambda - n) / self.n_plus_lambda
        self.wc[:, 0] = self.wm[:, 0] + 1 - alpha**2 + beta

    def offsets(self, p: np.ndarray) -> np.ndarray:
        """Return the sigma points relative to the center, (s, 2n + 1, n)."""
        root = np.empty_like(p)
        root[:, self.order] = cholesky(p[:, self.order][:, :, self.order])
        columns = np.sqrt(self.n_plus_lambda)[:, None, None] * transposed(root)
        return np.concatenate([np.zeros_like(columns[:, :1]), columns, -columns], axis=1)

    def _moments(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (s, m) and the points relative to it; the weights of the mean add up to one."""
        mean = points[:, 0] + np.einsum("sk,ski->si", self.wm, points - points[:, :1])
        return mean, (points - points[:, :1]) - (mean - points[:, 0])[:, None]

    def predict(self, mean, p, q, dt, imu) -> tuple[np.ndarray, np.ndarray]:
        moved, spread = self._moments(newton(mean[:, None], self.offsets(p), dt, imu))
        weighted = self.wc[..., None] * spread
        return coasted(mean, dt, imu[2]) + moved, transposed(weighted) @ spread + q

    def measure(self, mean, p, z: Measurement, r: np.ndarray) -> Innovation:
        offsets = self.offsets(p)
        moved, spread = self._moments(z.change(mean[:, None], offsets))
        weighted = self.wc[..., None] * spread
        s, c = transposed(weighted) @ spread + r, transposed(offsets) @ weighted
        return Innovation(z.innovation(mean) - moved, s, c, r)

    def correct(self, mean, p, seen: Innovation, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
        c, nu = whiten(seen.s, transposed(seen.c)), whiten(seen.s, seen.nu[..., None])
        return mean + (transposed(c) @ nu)[..., 0], p - transposed(c) @ c  # x + K nu, P - K S K^T


class JacobianForm:
    """The extended Kalman filter."""

    def predict(self, mean, p, q, dt, imu) -> tuple[np.ndarray, np.ndarray]:
        f = newton_jacobian(mean, dt, imu)
        moved = newton(mean[:, None], np.zeros_like(mean)[:, None], dt, imu)[:, 0]
        return coasted(mean, dt, imu[2]) + moved, f @ p @ transposed(f) + q

    def measure(self, mean, p, z: Measurement, r: np.ndarray) -> Innovation:
        h = z.jacobian(mean)
        return Innovation(z.innovation(mean), h @ p @ transposed(h) + r, p @ transposed(h), r)

    def correct(self, mean, p, seen: Innovation, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
        c = whiten(seen.s, transposed(seen.c))
        gain = transposed(c) @ whiten(seen.s, np.broadcast_to(np.eye(seen.s.shape[-1]), seen.s.shape))
        rest = np.eye(p.shape[-1], dtype=Extended) - gain @ z.jacobian(mean)
        new = rest @ p @ transposed(rest) + gain @ seen.r @ transposed(gain)
        return mean + (gain @ seen.nu[..., None])[..., 0], new


class ExtendedCar:
    """Filters of one type, model and choice of measurements on a drive's timeline, one per parameter set.

    Attributes
    ----------
    mean, covariance : (s, n), (s, n, n)
    q, r : (s, n), (s, 2), the diagonals of Q and R; an adaptive filter changes them
    recent : (s,), average size of the innovations for strong tracking; NaN before the first fix
    quick, slow, times_r : (s,), averages of NIS / 2 of a fuzzy filter, and the factor contained in R
    rejected : (s,), number of consecutive fixes that the gate has rejected
    lost : (s,), whether the last fix ended a run of outliers that is long enough for a recovery
    outliers, span : (s,), number of consecutive fixes with a small weight, and Q's scale from the first to the last
    since : Q's scale since the last fix
    prior : (s, n, n), the covariance before the update, including its scaling by a filter
    nis, log_determinant, squared_residual, weight : (s,), of the last fix
    """

    def __init__(self, timeline: Timeline, sets: Sequence[FilterParameters]) -> None:
        def column(name: str, without: float = 1.0) -> np.ndarray:
            values = [getattr(p, name) for p in sets]
            return np.array([without if value is None else value for value in values], dtype=Extended)

        self.line, self.kind, self.n = timeline, sets[0].kind, sets[0].n_states
        self.form = JacobianForm() if self.kind == "ekf" else SigmaPointForm(sets)
        self.axes, self.car = ("ax", "ay", "gz"), extended_car
        if self.n == 12:
            from oracles import extended_tilted  # it uses this module

            self.car = extended_tilted
            extended = self.kind == "ekf"
            self.form = extended_tilted.TiltedForm() if extended else extended_tilted.TiltedPoints(sets)
            self.axes = ("ax", "ay", "az", "gx", "gy", "gz")
        nominal = Extended(timeline.nominal_interval)
        self.q = np.array([p.process_noise for p in sets], dtype=Extended)
        self.q *= (nominal / column("nominal_interval", timeline.nominal_interval))[:, None]
        self.r = np.array([p.measurement_noise for p in sets], dtype=Extended)
        self.velocity_noise, self.lateral_noise = column("velocity_noise"), column("lateral_noise")
        self.standstill_noise, self.axle = column("standstill_noise"), column("rear_axle")
        self.tire_slip = column("tire_slip")
        self.odometer_noise, self.odometer_scale = column("odometer_noise"), column("odometer_scale")
        self.odometer_latency = column("odometer_latency")
        self.gate, self.latency = column("gate", np.inf), column("latency")
        self.forgetting = column("forgetting")
        self.recent = np.full(len(sets), np.nan, dtype=Extended)
        self.quick, self.slow, self.times_r = np.ones((3, len(sets)), dtype=Extended)
        self.times_q = np.ones(len(sets), dtype=Extended)
        self.widths, self.gains = (
            np.array([getattr(p, name) for p in sets], dtype=Extended).T
            for name in ("fuzzy_widths", "fuzzy_gains")
        )
        self.rejected = np.zeros(len(sets), dtype=int)
        self.accuracy, self.dof = column("accuracy_scale", 0.0), column("robust_dof", np.inf)
        self.robust = bool(np.isfinite(self.dof).any())
        self.outliers = np.zeros(len(sets), dtype=int)
        self.span = np.zeros(len(sets), dtype=Extended)
        self.patience = (5 - Extended("1e-6")) / nominal
        self.since = Extended(0)

    def step(self, i: int, happens: int, z: np.ndarray | None, wheels: np.ndarray | None = None) -> None:
        """Run step i of the timeline: predict, then update with the measurements in ``happens``.

        ``wheels`` contains the mean of odometer readings, their age, and the addition to R.
        """
        line = self.line
        dt, scale = Extended(line.dt[i]), Extended(line.q_scale[i])
        imu = line.imu(self.axes)[i].astype(Extended)
        q = np.eye(self.n, dtype=Extended) * (self.q * scale)[:, None]
        self.mean, self.covariance = self.form.predict(self.mean, self.covariance, q, dt, imu)
        self.covariance = self.covariance + self._unseen(dt, Extended(line.gap[i]))
        self.prior = self.covariance
        self.since += scale
        if happens & FIX and z is not None:
            self._absorb_fix(self.car.fix(z[:2], line.lever, self.latency), z[4:6].astype(Extended))
            self.since = Extended(0)
            if happens & VELOCITY:
                self._absorb(self.car.linear(z[2:4], [2, 3]), self.velocity_noise)
        if happens & LATERAL:
            self._absorb(self.car.lateral(line.gz[i], self._arm()), self.lateral_noise)
        if happens & ODOMETER and wheels is not None:
            speed, age, more = wheels.astype(Extended)
            told = self.car.odometer(speed / self.odometer_scale, line.ax[i], self.odometer_latency + age)
            self._absorb(told, self.odometer_noise + more, SLIPS)
        if happens & STANDSTILL:
            self._absorb(self.car.linear(np.zeros(2), [2, 3]), self.standstill_noise)
            biases = {5: [], 8: [7], 12: [7, 10, 11]}[self.n]
            if biases:
                shown = line.imu(("gz", "gx", "gy"))[i] if self.n == 12 else line.imu(("gz",))[i]
                noise = np.full(len(self.mean), GYRO_AT_REST)
                self._absorb(self.car.linear(shown, biases), noise)

    def _unseen(self, dt: Extended, gap: Extended) -> np.ndarray:
        """Return the addition of a gap to P: G a G^T + turn, for an acceleration of variance a = sigma^2 gap / dt."""
        g = np.zeros((self.n, 2), dtype=Extended)
        g[:4] = np.kron(
            [[dt / 2], [Extended(1)]], np.eye(2, dtype=Extended)
        )  # displacement is half of dt times the change of velocity
        added = g @ transposed(g) * GAP_ACCELERATION**2 * gap * dt
        added[4, 4] = GAP_TURN**2 * gap * dt
        if self.n == 12:
            added[8, 8] = added[9, 9] = GAP_TILT**2 * gap * dt
        return added

    def _arm(self) -> np.ndarray:
        """Return the distance from the point without lateral velocity to the IMU, (s,) m."""
        return self.axle - self.tire_slip * np.sum(self.mean[:, 2:4] ** 2, axis=1)

    def _absorb(self, z: Measurement, variance: np.ndarray, gate: float = np.inf) -> None:
        r = variance[:, None, None] * np.eye(z.jacobian(self.mean).shape[1], dtype=Extended)
        seen = self.form.measure(self.mean, self.covariance, z, r)
        mean, covariance = self.form.correct(self.mean, self.covariance, seen, z)
        used = self.used = _nis(seen) <= gate if gate < np.inf else np.ones(len(mean), dtype=bool)
        self.mean = np.where(used[:, None], mean, self.mean)
        self.covariance = np.where(used[:, None, None], covariance, self.covariance)

    def _absorb_fix(self, z: Measurement, stated: np.ndarray) -> None:
        r = np.eye(2, dtype=Extended) * (self.r + (self.times_r * self.accuracy)[:, None] * stated)[:, None]
        seen = self.form.measure(self.mean, self.covariance, z, r)
        self.nis = _nis(seen)  # before S is scaled: NIS of a prediction must not depend on the fix
        self.log_determinant = np.log(seen.s[:, 0, 0] * seen.s[:, 1, 1] - seen.s[:, 0, 1] * seen.s[:, 1, 0])
        used = (self.nis <= self.gate) | (self.rejected >= MOST_REJECTED)
        self.rejected = np.where(used, 0, self.rejected + 1)
        if self.kind == "strong-tracking-ukf":
            self._fade(seen, used)
        if self.kind == "fuzzy-ukf":
            r = self._reason(seen, used)
        if self.robust:
            r = self._weigh(seen)
        # In terms of z: M = S - R is the predicted variance, so that M S^-1 nu is the update.
        m = seen.s - r
        known, nu = whiten(seen.s, m), whiten(seen.s, seen.nu[..., None])
        residual = seen.nu - (transposed(known) @ nu)[..., 0]
        self.squared_residual = np.sum(np.where(used[:, None], residual, seen.nu) ** 2, axis=1)
        mean, covariance = self.form.correct(self.mean, self.covariance, seen, z)
        if self.kind == "adaptive-ukf":
            moved = (transposed(whiten(seen.s, transposed(seen.c))) @ nu)[..., 0]  # K nu
            self._adapt(used, residual, m - transposed(known) @ known, moved, covariance)
        self.mean = np.where(used[:, None], mean, self.mean)
        self.covariance = np.where(used[:, None, None], covariance, self.covariance)

    def _weigh(self, seen: Innovation) -> np.ndarray:
        """Apply the weights of Piche, Sarkka and Hartikainen, or recover; return the R of the update."""
        r, m = seen.r, seen.s - seen.r
        inverse = np.eye(2, dtype=Extended) / diagonal(r)[..., None]
        weight = np.ones(len(r), dtype=Extended)
        for _ in range(3):
            heavy = r / weight[:, None, None]
            gain, e = whiten(m + heavy, heavy), whiten(m + heavy, seen.nu[..., None])
            residual = transposed(gain) @ e
            left = heavy - transposed(gain) @ gain
            gamma = (transposed(residual) @ inverse @ residual)[:, 0, 0] + diagonal(inverse @ left).sum(
                axis=1
            )
            weight = np.where(np.isinf(self.dof), 1, (self.dof + 2) / (self.dof + gamma))
        far = weight < 0.25
        self.span = np.where(far & (self.outliers > 0), self.span + self.since, 0)
        self.outliers = np.where(far, self.outliers + 1, 0)
        lost = self.lost = (self.outliers >= 3) & (self.span >= self.patience)
        self.outliers, self.span = np.where(lost, 0, self.outliers), np.where(lost, 0, self.span)
        self.weight = np.where(lost, 1, weight)
        heavy = r / self.weight[:, None, None]
        seen.s, seen.r = m + heavy, heavy
        self._stretch(seen, lost, np.sum(seen.nu**2, axis=1))
        return heavy

    def _reason(self, seen: Innovation, used: np.ndarray) -> np.ndarray:
        """Scale Q and R by rules on the size of the innovations; return the R of the update.

        Each fix moves the averages towards its NIS / 2 (at most 10), by 1 - forgetting and by a quarter of that.
        """
        size = np.minimum(self.nis / 2, 10)
        step = np.where(used, 1 - self.forgetting, 0)
        self.quick, self.slow = (
            (1 - s) * old + s * size for s, old in ((step, self.quick), (step / 4, self.slow))
        )
        edge = 2 * self.quick / (1 + self.quick) - 1, 1 - 2 * self.slow / (self.quick + self.slow)
        high, rises = (np.clip(value / width, -1, 1) for value, width in zip(edge, self.widths, strict=True))
        large, small, rises = np.maximum(high, 0), np.maximum(-high, 0), np.maximum(rises, 0)
        r, q = (1 + large * (gain - 1) + small * (1 / gain - 1) for gain in self.gains)
        q -= large * rises * (self.gains[1] - 1)
        r, q = np.where(used, r, self.times_r), np.where(used, q, self.times_q)
        times = (r / self.times_r)[:, None]
        self.r, self.q = times * self.r, (q / self.times_q)[:, None] * self.q
        self.times_r, self.times_q = r, q
        noise = times[..., None] * seen.r
        seen.s, seen.r = seen.s - seen.r + noise, noise
        return noise

    def _fade(self, seen: Innovation, used: np.ndarray) -> None:
        """Scale the covariance for strong tracking."""
        size, rho = np.sum(seen.nu**2, axis=1), self.forgetting
        recent = np.where(np.isnan(self.recent), size, rho * self.recent + (1 - rho) * size)
        self.recent = np.where(used, recent, self.recent)
        self._stretch(seen, used, recent)

    def _stretch(self, seen: Innovation, used: np.ndarray, size: np.ndarray) -> None:
        """Set P + (factor - 1) C (H P H^T)^-1 C^T with H = C^T P^-1 and the factor from the traces."""
        root = whiten(self.covariance, seen.c)
        hph = transposed(root) @ root
        factor = (size - diagonal(seen.r).sum(axis=1)) / diagonal(hph).sum(axis=1)
        factor = np.where(used, np.maximum(factor, 1), 1)[:, None, None]
        part = whiten(hph, transposed(seen.c))
        self.covariance = self.covariance + (factor - 1) * transposed(part) @ part
        self.prior = self.covariance  # the covariance before the update
        seen.s = seen.s + (factor - 1) * hph
        seen.c = factor * seen.c

    def _adapt(self, used, residual, left, moved, covariance) -> None:
        """Adapt by Sage and Husa, with constant weights: Q and R move towards the estimates from a fix.

        The estimate of R is eps eps^T + M+, with eps (s, 2) the ``residual`` and M+ the updated variance ``left``.
        That of Q is the square of the correction ``moved``, + P+ - (P- - Q), but not below zero.
        """
        weight = np.where(used, 1 - self.forgetting, 0)[:, None]
        self.r = (1 - weight) * self.r + weight * (residual**2 + diagonal(left))
        change = (moved**2 + diagonal(covariance) - diagonal(self.covariance)) / self.since
        self.q = (1 - weight) * self.q + weight * np.maximum(self.q + change, 0)


def _nis(seen: Innovation) -> np.ndarray:
    return np.sum(whiten(seen.s, seen.nu[..., None]) ** 2, axis=(1, 2))
