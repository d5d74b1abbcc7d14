"""Weights of errors by the accuracy of truth, and detection of a constant offset between truth and fixes."""

import math

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.windows import Complex
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gaps import is_known
from sigmaswarm.drives.tables import Truth

POSITION_FLOOR = 0.3
"""Standard deviation of truth, m per axis, below which the weight hardly increases.

The value is the accuracy of the best filters with cheap receivers. Without this limit, parts under open sky, where
every filter is accurate, would have nearly all of the weight.
"""
HEADING_FLOOR = math.radians(0.3)  # rad, the same limit for the true heading
N_BLOCKS = 8  # parts of a drive; the spread of the offset over them shows the effect of correlated errors
MIN_OFFSET_SIGMAS = 5.0  # smallest ratio of a reported offset to its standard deviation
MIN_OFFSET = 0.3, 0.3  # smallest reported offset: m, and as a fraction of the scatter of the fixes


def weights_at(truth: Truth, time: Array) -> Array | None:
    """Return the weights floor^2 / (sigma^2 + floor^2) of squared position errors at ``time``, s; None if all are 1.

    sigma^2 is the mean variance of both axes.
    """
    if truth.std is None:
        return None
    std_x, std_y = (np.interp(time, truth.time, std) for std in truth.std)
    return POSITION_FLOOR**2 / ((std_x**2 + std_y**2) / 2 + POSITION_FLOOR**2)


def heading_weights(truth: Truth) -> Array | None:
    """Return the weights of squared heading errors, shape (m,); None if all are 1."""
    return None if truth.std_theta is None else HEADING_FLOOR**2 / (truth.std_theta**2 + HEADING_FLOOR**2)


def root_mean(squares: Array, weights: Array | None = None) -> float:
    """Return the weighted RMS from squared errors; NaN if there are no errors."""
    if not squares.size:
        return float("nan")
    return float(np.sqrt(np.mean(squares) if weights is None else np.average(squares, weights=weights)))


def truth_offset(drive: Drive) -> str:
    """Return a sentence on a constant offset of the fixes from truth, with a remedy; "" if there is no offset.

    The offset is constant in the map frame (east, north) or in the vehicle frame (forward, left). The function chooses
    the frame in which the medians of `N_BLOCKS` parts of the drive agree better.
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
    least = max(MIN_OFFSET[0], MIN_OFFSET[1] * scatter)
    if max(world_clear, body_clear) < MIN_OFFSET_SIGMAS or abs(offset) < least:
        return ""
    origin = (
        f"if the truth has another origin or datum, import with --origin, or add {world.real:.2f} and "
        f"{world.imag:.2f} m to x and y of truth.csv"
    )
    length = arm + body
    lever = (
        "if the antenna is not at the point to which the truth refers, write "
        f"gps_lever_arm_m = [{length.real:.2f}, {length.imag:.2f}, 0.0] at the top of drive.toml"
    )
    causes = [
        cause
        for cause, clear, other in ((lever, body_clear, world_clear), (origin, world_clear, body_clear))
        if clear > MIN_OFFSET_SIGMAS and clear > other / 2  # a straight road does not distinguish the frames
    ]
    return (
        f"the fixes of {drive.name} have a constant offset of {abs(offset):.2f} m from the truth; all position "
        f"errors contain this offset. It is {world.real:+.2f} m east and {world.imag:+.2f} m north, or "
        f"{body.real:+.2f} m forward and {body.imag:+.2f} m left. Remedy: {'; '.join(causes)}"
    )


def _constant(error: Complex) -> tuple[complex, float]:
    """Return the mean of the medians of `N_BLOCKS` parts (m) and the ratio of this mean to its standard deviation."""
    if len(error) < 2 * N_BLOCKS:
        return 0j, 0.0
    parts = np.array_split(error, N_BLOCKS)
    means = np.array([np.median(part.real) + 1j * np.median(part.imag) for part in parts])
    mean = complex(np.mean(means))
    std = float(np.sqrt(np.sum(np.abs(means - mean) ** 2) / (N_BLOCKS - 1) / N_BLOCKS))
    return mean, abs(mean) / max(std, 1e-9)
