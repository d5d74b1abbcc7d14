"""A constant offset between fixes and truth: an antenna away from the IMU, or another origin or datum."""

import numpy as np

from sigmaswarm.doctor.windows import Complex
from sigmaswarm.drives.drive import Drive
from sigmaswarm.scoring.truth_noise import is_known

BLOCKS = 8
"""Number of stretches of a drive, whose means show the spread of correlated errors."""
CLEAR = 5.0
"""Standard deviations of the mean from which an offset is reported."""
SIMILAR = 0.5
"""Share of the other frame's deviations from which both are reported: a straight road does not distinguish them."""
LEAST = 0.3, 0.3
"""m, and share of the fixes' scatter: smaller offsets do not matter."""


def truth_offset(drive: Drive) -> str:
    """Return a sentence on a constant offset of the fixes from truth, with its remedy; empty where there is none.

    The fixes' errors are averaged along east and north, and along forward and left of the vehicle. The offset is
    constant in the frame in which the averages of `BLOCKS` stretches agree better.
    """
    gps, truth = drive.gps, drive.truth
    if truth is None or len(truth) < 2 or not np.any(used := is_known(truth, gps.time)):
        return ""
    time = gps.time[used]
    heading = np.exp(1j * np.interp(time, truth.time, np.unwrap(truth.theta)))
    x, y = (np.interp(time, truth.time, column) for column in (truth.x, truth.y))
    arm = complex(*drive.lever_arm)
    error = gps.x[used] - x + 1j * (gps.y[used] - y) - arm * heading
    (world, world_clear), (body, body_clear) = _constant(error), _constant(error / heading)
    offset = world if world_clear > body_clear else body
    scatter = float(np.median(np.abs(error - np.median(error.real) - 1j * np.median(error.imag))))
    if max(world_clear, body_clear) < CLEAR or abs(offset) < max(LEAST[0], LEAST[1] * scatter):
        return ""
    origin = (
        f"the truth has another origin or datum: import with --origin, or add {world.real:.2f} and {world.imag:.2f} m "
        "to x and y of truth.csv"
    )
    length = arm + body
    lever = (
        "the antenna is not at the position of the truth: write "
        f"gps_lever_arm_m = [{length.real:.2f}, {length.imag:.2f}, 0.0] into drive.toml"
    )
    causes = [
        cause
        for cause, clear, other in ((lever, body_clear, world_clear), (origin, world_clear, body_clear))
        if clear > CLEAR and clear > SIMILAR * other
    ]
    return (
        f"the fixes of {drive.name} lie {abs(offset):.2f} m from the truth on average ({world.real:+.2f} m east, "
        f"{world.imag:+.2f} m north; {body.real:+.2f} m forward, {body.imag:+.2f} m left), and all position errors "
        f"contain this offset: {'; or '.join(causes)}"
    )


def _constant(error: Complex) -> tuple[complex, float]:
    """Return the mean of the means of stretches, m, and its ratio to its standard deviation."""
    if len(error) < 2 * BLOCKS:
        return 0j, 0.0
    means = np.array(
        [np.median(part.real) + 1j * np.median(part.imag) for part in np.array_split(error, BLOCKS)]
    )
    mean = complex(np.mean(means))
    std = float(np.sqrt(np.sum(np.abs(means - mean) ** 2) / (BLOCKS - 1) / BLOCKS))
    return mean, abs(mean) / max(std, 1e-9)
