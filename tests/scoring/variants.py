"""A drive with truth at other times: more or fewer of them, later, or over a shorter time than the IMU."""

from dataclasses import replace

import numpy as np

from sigmaswarm.drives.drive import Drive, Truth
from support import make_drive


def resampled(truth: Truth, time: np.ndarray) -> Truth:
    columns = (truth.x, truth.y, truth.vx, truth.vy, np.unwrap(truth.theta))
    return Truth(time, *(np.interp(time, truth.time, column) for column in columns))


def truth_variants(drive: Drive) -> dict[str, Drive]:
    """Return the same drive with truth at other times."""
    end = drive.imu.time[-1]
    times = {
        "as-imu": drive.truth.time,
        "ten-times-the-imu": np.arange(0.0, end, 0.0011),
        "1-hz": np.arange(0.35, end, 1.0),
        "starts-late": np.arange(12.3456, end, 0.05),
        "ends-early": np.arange(-2.0, 14.2, 0.05),
        "three-moments": np.array([9.001, 9.002, 15.5]),
    }
    return {name: replace(drive, truth=resampled(drive.truth, time)) for name, time in times.items()}


DRIVE = make_drive(duration=20.0, jitter=0.3, seed=4)
VARIANTS = truth_variants(DRIVE)
