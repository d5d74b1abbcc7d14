"""The roll and pitch rates: signs and columns of gx and gy, which planar filters do not use.

Within half a second the direction of the specific force turns against the body as the body turns (g' = -w x g). The
car's own acceleration turns it too, but a body that rolls and pitches on its springs leans the same way: in a left
turn the force points to the left and the left side comes up. So the signs show on flat roads as well; the sizes do not.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of
from sigmaswarm.doctor.windows import moving_mean
from sigmaswarm.doctor.yaw_fit import integral
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Array

SMOOTHED, LAG = 0.3, 0.5
"""s: over which the force is averaged, and over which its direction changes. Longer ones show more of the car's own
acceleration, shorter ones more shaking. On seven recordings every right sign stands out by 9.5 deviations or more."""
CLEAR = 7.0
"""Deviations; neighboring changes share samples, so that these are optimistic."""
CLEARER = 2.0
"""Times the other column's deviations."""
OUTLYING = 3.0
"""Deviations, from which on a change does not count."""


@dataclass(frozen=True)
class _Follows:
    """Rate that a direction follows (0: gx, 1: gy), its sign, and the significance in deviations."""

    column: int
    sign: float
    deviations: float


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about gx and gy; none where a column of the three axes is missing, or gravity is not in az."""
    read = _read(evidence)
    if read is None:
        return
    roll, pitch = _follow(evidence.drive.imu.time, *read)
    span, where = evidence.span, "imu.csv, gx, gy"
    exchanged = [f for f, right in ((roll, 0), (pitch, 1)) if f is not None and f.column != right]
    sure = min((f.deviations for f in (roll, pitch) if f is not None), default=0.0)
    if exchanged and not (roll and pitch and roll.column != pitch.column):
        return  # one of them alone, or both after one column: that is no exchange, and nothing to build on
    if exchanged:
        assert roll is not None
        assert pitch is not None
        names = [f"{'-' if f.sign < 0 else ''}{('gx', 'gy')[f.column]}" for f in (roll, pitch)]
        yield Finding(
            "gyro-tilt", "warning",
            f"the roll rate stands in {names[0]}, the pitch rate in {names[1]}: so the direction of gravity turns",
            where, span, confidence_of(sure / 2), f"read gx as {names[0]} and gy as {names[1]}",
            Repair("tilt-rates", (0.0, roll.sign, pitch.sign, 0.0)),
        )  # fmt: skip
        return
    wrong = [f for f in (roll, pitch) if f is not None and f.sign < 0]
    if wrong:
        names = " and ".join(("gx", "gy")[f.column] for f in wrong)
        yield Finding(
            "gyro-tilt", "warning",
            f"{names} {'have' if len(wrong) > 1 else 'has'} the wrong sign against how gravity turns: the roll rate "
            "gx must be positive where the left side comes up, the pitch rate gy where the nose goes down",
            f"imu.csv, {', '.join(('gx', 'gy')[f.column] for f in wrong)}", span,
            confidence_of(min(f.deviations for f in wrong) / 2), f"change the sign of {names}",
            Repair("tilt-rates", (roll.sign if roll else 1.0, 0.0, 0.0, pitch.sign if pitch else 1.0)),
        )  # fmt: skip
    unseen = [name for name, f in (("gx", roll), ("gy", pitch)) if f is None]
    if unseen:
        names = " and ".join(unseen)
        yield Finding(
            "unseen-tilt", "note",
            f"the body hardly {'rolls' if unseen == ['gx'] else 'pitches' if unseen == ['gy'] else 'rolls or pitches'}"
            f" as far as the forces show: the sign of {names} can't be checked",
            f"imu.csv, {', '.join(unseen)}", span, 0.95, "use a drive with turns, starts and stops to check it",
        )  # fmt: skip


def _read(evidence: Evidence) -> tuple[Array, Array] | None:
    """Specific force and angular rates, (3, n), as they are once the other findings are mended."""
    imu, mount, yaw = evidence.drive.imu, evidence.mount, evidence.yaw
    if imu.az is None or imu.gx is None or imu.gy is None:
        return None
    matrix = mount.matrix if mount is not None else np.eye(2)
    level = matrix @ np.array([imu.ax, imu.ay])
    up = float(np.median(np.abs(imu.az)))
    unit = GRAVITY if 0.8 < up < 1.2 else 1.0
    if not 0.7 * GRAVITY < unit * up < 1.3 * GRAVITY:
        return None
    force = np.array([*level, unit * np.sign(np.median(imu.az)) * imu.az])
    rates = {"gx": imu.gx, "gy": imu.gy, "gz": imu.gz}
    rates["gz"], rates[yaw.column] = rates[yaw.column], rates["gz"]
    factor = abs(yaw.factor)
    return force, np.array([factor * rates["gx"], factor * rates["gy"], yaw.factor * rates["gz"]])


def _follow(time: Array, force: Array, rates: Array) -> tuple[_Follows | None, _Follows | None]:
    """Find the rates that the roll and the pitch of the direction follow; None where unclear."""
    interval = float(np.median(np.diff(time)))
    count, lag = (max(round(seconds / interval), 1) for seconds in (SMOOTHED, LAG))
    mean = moving_mean(force, count)
    direction = mean / np.maximum(np.linalg.norm(mean, axis=0), 0.1 * GRAVITY)
    turned = moving_mean(np.array([integral(time, rate) for rate in rates]), count)
    first = np.arange(0, len(time) - lag, max(lag // 2, 1))
    first = first[time[first + lag] - time[first] < 2 * LAG]  # over a gap the rates are not known
    if len(first) < 20:
        return None, None
    change = direction[:, first + lag] - direction[:, first]
    angle = turned[:, first + lag] - turned[:, first]
    return _clear(_deviations(angle, change[1])), _clear(-_deviations(angle, change[0]))


def _deviations(angle: Array, change: Array) -> Array:
    """Factors of the turns about x and y in the change, over their deviations; a robust least squares.

    The turn about z takes its part, which a tilted sensor and cornering give it.
    """
    columns = np.column_stack([*angle, np.ones(len(change))])
    scale = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(scale > 0, scale, 1.0)
    factors, left = _least_squares(columns, change, np.ones(len(change), dtype=np.bool_))
    kept = np.ones(len(change), dtype=np.bool_)
    for _ in range(2):
        kept = np.abs(left) <= OUTLYING * float(np.median(np.abs(left))) / 0.6745 + 1e-9
        factors, left = _least_squares(columns, change, kept)
    covariance = np.linalg.pinv(columns[kept].T @ columns[kept]) * (np.var(left[kept]) + 1e-18)
    return factors[:2] / np.sqrt(np.maximum(np.diag(covariance)[:2], 1e-30))


def _least_squares(columns: Array, change: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Factors of the columns by the rows that are kept, and what is left of all rows."""
    factors = np.asarray(np.linalg.lstsq(columns[kept], change[kept], rcond=None)[0], np.float64)
    return factors, change - columns @ factors


def _clear(deviations: Array) -> _Follows | None:
    column = int(np.argmax(np.abs(deviations)))
    size, other = float(abs(deviations[column])), float(abs(deviations[1 - column]))
    if size < max(CLEAR, CLEARER * other):
        return None
    return _Follows(column, float(np.sign(deviations[column])), size)
