"""kalman-py's UnscentedKalmanFilter on JAX, with the time loop compiled.

Its `filter` has no input and needs a measurement at every step. Therefore, the process reads its IMU sample by the
number of the step, which is passed as ``dt``, and the drive must have a fix at every IMU sample. `check` compares the
results with sigmaswarm's filter on the same drive.
"""

import jax
import jax.numpy as jnp
import numpy as np
from kalman_py import UnscentedKalmanFilter

from sigmaswarm import Drive, FilterParameters, InitialState, run_filter
from sigmaswarm.drives.prepared import prepare_drive

jax.config.update("jax_enable_x64", True)


def position(states):
    return states[..., :2]


class Rival:
    """kalman-py's filter for a drive that has a fix at every IMU sample, and one parameter set."""

    def __init__(self, drive: Drive, p: FilterParameters, initial: InitialState) -> None:
        line = prepare_drive(drive, initial).timeline()
        assert line.updates.all() and line.sampled.all()
        np.testing.assert_allclose(line.q_scale, 1.0, atol=1e-9)  # its Q is the same at every step
        self.fixes, self.steps = line.fixes[:, :2], np.arange(len(line.dt), dtype=float)
        inputs = jnp.array(np.column_stack([line.dt, line.ax, line.ay, line.gz]))

        def process(states, step):
            dt, ax, ay, gz = inputs[step.astype(int)]
            x, y, u, v, theta = (states[..., i] for i in range(5))
            sin, cos = jnp.sin(theta), jnp.cos(theta)
            east, north = cos * ax - sin * ay, sin * ax + cos * ay
            h = 0.5 * dt * dt
            moved = x + u * dt + east * h, y + v * dt + north * h, u + east * dt, v + north * dt
            return jnp.stack([*moved, theta + gz * dt], axis=-1)

        q, r = np.diag(p.process_noise), np.diag(p.measurement_noise)
        self.ukf = UnscentedKalmanFilter(
            process, position, q, r, initial.mean, initial.covariance,
            alpha=p.alpha, beta=p.beta, kappa=p.kappa, vectorized=True,
        )  # fmt: skip

    def means(self) -> np.ndarray:
        """Means at the IMU samples, (n, 5); the first call compiles."""
        return np.asarray(self.ukf.filter(self.fixes, self.steps, backend="jax").means)


def check(rival: Rival, drive: Drive, p: FilterParameters, initial: InitialState) -> None:
    """Raise AssertionError unless the final positions of both filters are nearly equal; their sigma points differ."""
    ours = run_filter(drive, p, initial=initial).mean
    assert np.sqrt(np.mean((rival.means()[:, :2] - ours[: len(rival.steps), :2]) ** 2)) < 1e-3
