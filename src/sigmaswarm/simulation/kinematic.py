"""A first, plain simulator: kinematics in the plane, white noise and biases, so that a demo needs no files."""

import numpy as np

from sigmaswarm.drives.drive import Array, Drive, Gps, Imu, Truth

G = 9.80665
"""m/s2."""


def simulate(
    *,
    duration: float = 90.0,
    imu_rate: float = 100.0,
    gps_rate: float = 5.0,
    gps_std: float = 1.0,
    accel_std: float = 0.05,
    gyro_std: float = 0.002,
    accel_bias_std: float = 0.2,
    gyro_bias_std: float = 0.003,
    seed: int = 0,
    name: str | None = None,
) -> Drive:
    """Simulate a drive through a town: straights, turns, stops; a flat road, no slip.

    Parameters
    ----------
    duration : float
        s.
    imu_rate, gps_rate : float
        Hz.
    gps_std : float
        m per axis.
    accel_std, gyro_std : float
        m/s2, rad/s: standard deviation of one sample's white noise.
    accel_bias_std, gyro_bias_std : float
        m/s2, rad/s: standard deviation of the constant bias that each axis has for the whole drive.
    seed : int
        Decides route and noise.
    name : str, optional

    Returns
    -------
    Drive
        With exact truth, and sensor noise stated in ``metadata``.
    """
    route, noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    # Integrate on a fine grid that holds every sample of both sensors.
    fine = 10
    n = round(duration * imu_rate) * fine
    dt = 1.0 / (imu_rate * fine)
    time: Array = np.arange(n + 1, dtype=np.float64) * dt
    speed, yaw_rate = _maneuvers(time, route)
    theta = route.uniform(-np.pi, np.pi) + _integral(yaw_rate, dt)
    vx, vy = speed * np.cos(theta), speed * np.sin(theta)
    x, y = _integral(vx, dt), _integral(vy, dt)
    acceleration = np.gradient(speed, dt)

    at_imu = slice(0, n + 1, fine)
    shape = len(time[at_imu])

    def measured(exact: Array | float, std: float, bias_std: float) -> Array:
        return exact + bias_std * noise.standard_normal() + std * noise.standard_normal(shape)

    imu = Imu(
        time=time[at_imu],
        ax=measured(acceleration[at_imu], accel_std, accel_bias_std),
        ay=measured((speed * yaw_rate)[at_imu], accel_std, accel_bias_std),
        gz=measured(yaw_rate[at_imu], gyro_std, gyro_bias_std),
        az=measured(G, accel_std, accel_bias_std),
    )
    fix: Array = np.arange(0.0, duration, 1.0 / gps_rate, dtype=np.float64)
    gps = Gps(
        time=fix,
        x=np.interp(fix, time, x) + gps_std * noise.standard_normal(len(fix)),
        y=np.interp(fix, time, y) + gps_std * noise.standard_normal(len(fix)),
        std_x=np.full(len(fix), gps_std),
        std_y=np.full(len(fix), gps_std),
    )
    truth = Truth(time[at_imu], x[at_imu], y[at_imu], vx[at_imu], vy[at_imu], theta[at_imu])
    metadata = {
        "source": "sigmaswarm simulate (plane kinematics, white noise, constant biases)",
        "seed": seed,
        "accel_noise_density": accel_std / np.sqrt(imu_rate),
        "gyro_noise_density": gyro_std / np.sqrt(imu_rate),
        "gps_std_m": gps_std,
    }
    return Drive(name or f"simulated-{seed:03d}", imu, gps, truth, metadata=metadata)


def _maneuvers(time: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Speed (m/s) and yaw rate (rad/s) of a car that goes through town, both smooth."""
    speed, yaw_rate = np.full_like(time, 10.0), np.zeros_like(time)
    t = 8.0
    while t < time[-1]:
        kind = rng.choice(["straight", "turn", "turn", "stop"])
        length = rng.uniform(4.0, 8.0)
        bump = _bump(time, t, length)
        if kind == "turn":  # slow to about 6 m/s, turn by 90 degrees, speed up again
            speed -= 4.0 * bump
            angle = rng.choice([-1, 1]) * np.radians(rng.uniform(70, 100))
            yaw_rate += angle * bump / (bump.sum() * (time[1] - time[0]) + 1e-12) * _share(time, t, length)
        elif kind == "stop":
            length = rng.uniform(10.0, 14.0)
            speed -= 10.0 * np.minimum(1.0, 1.6 * _bump(time, t, length))
        else:
            speed += rng.uniform(0.0, 4.0) * bump
        t += length + rng.uniform(1.0, 4.0)
    return np.maximum(speed, 0.0), yaw_rate


def _bump(time: Array, start: float, length: float) -> Array:
    """0 outside (start, start + length), smoothly up to 1 and down again inside."""
    phase = np.clip((time - start) / length, 0.0, 1.0)
    return np.sin(np.pi * phase) ** 2


def _share(time: Array, start: float, length: float) -> float:
    """How much of a bump lies before the drive's end, so that a cut turn is not made sharper."""
    return float(np.clip((time[-1] - start) / length, 0.0, 1.0))


def _integral(values: Array, dt: float) -> Array:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt)])
