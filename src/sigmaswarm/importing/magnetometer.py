"""Compute a magnetometer's heading at the times of the fixes, calibrated with the course of the same drive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.evidence import gather as gather_evidence
from sigmaswarm.doctor.windows import integral, smoothed
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.joining import join
from sigmaswarm.importing.mounting import parse_mount
from sigmaswarm.importing.positions import Say, Values
from sigmaswarm.importing.recipe import Recipe

MIN_HEADING_RANGE = 180  # deg, part of the circle that the headings must cover to determine the hard iron
BIN = 10  # deg, width of a bin of headings
MIN_SAMPLES = 5  # smallest number of samples in a covered bin
DRIFT_TIME = 10.0  # s, interval over which the difference between course and integrated gyro is averaged
MAX_ROWS = 20_000  # rows for the calibration, evenly spread over the drive
# Largest deviation of the field's magnitude (relative) or direction (rad) without steel nearby, in robust standard
# deviations; the limit is at least the second value, relative or rad
MAX_FIELD_DEVIATION = 4.0, 0.03
MARGIN = 1.0  # s; fixes within this time of a larger deviation have no heading
# rad, largest standard deviation of the heading; a larger one shows a magnetometer that is not fixed to the vehicle
MAX_HEADING_STD = np.radians(20)
MIN_STD = np.radians(0.5)  # rad, smallest stated standard deviation
MAX_GAP = 1.0  # s, longest interval between samples that is interpolated
_UNLIKE = (
    "mag: the rotation of the field differs from that of the vehicle (course, gyro); map other columns, or omit the "
    "magnetometer"
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Model of the horizontal field: ``center + shape @ (cos(heading), sin(heading))``."""

    center: Array  # (2,), the hard iron, in the log's unit
    shape: Array  # (2, 2), with soft iron and rotation of the sensor; determinant < 0 for x forward, y left, z up

    @property
    def soft_iron(self) -> float:
        """Ratio of the ellipse's longer axis to the shorter one, minus 1."""
        sizes = np.linalg.svd(self.shape, compute_uv=False)
        return float(sizes[0] / sizes[1] - 1)

    @property
    def mirrored(self) -> bool:
        """True if an axis has the wrong sign or x and y are exchanged."""
        return bool(np.linalg.det(self.shape) > 0)

    @property
    def declination(self) -> float:
        """Angle from true to magnetic north, rad, clockwise, plus the sensor's rotation about the vertical axis."""
        left, _, right = np.linalg.svd(self.shape)  # orthogonal factor of the polar decomposition
        (sin, cos), _ = left @ right
        return float(np.arctan2(sin, cos))


def with_magnetometer(
    drive: Drive, parts: Sequence[PartColumns], recipe: Recipe, say: Say, recording: int | None
) -> Drive:
    if drive.gps.heading is not None:
        raise InputError(
            'mag: the fixes already have a heading; omit it with --map "gps.heading=", or omit the magnetometer'
        )
    samples = join(parts, "mag", ("mx", "my"), say, recording)
    zero = int(drive.metadata.get("time_origin_s", 0))
    time, field = (samples.time - zero * SECOND) / SECOND, _in_vehicle(samples.values, recipe.mount)
    evidence = gather_evidence(drive)
    late = evidence.clock.delay if abs(evidence.clock.delay) > evidence.clock.least else 0.0
    reference, moving = _reference(evidence, time, late)
    turned = _turned(reference[moving])
    if turned < MIN_HEADING_RANGE:
        raise InputError(
            f"mag: the headings in motion cover {turned} of 360 deg, too little to estimate the hard iron "
            f"({MIN_HEADING_RANGE} deg are needed); import a drive with more turns, or omit the magnetometer"
        )
    calibration = calibrate(reference[moving], field[moving])
    vector: Array = (field - calibration.center) @ np.linalg.inv(calibration.shape).T
    off: Array = wrap_angle(np.arctan2(vector[:, 1], vector[:, 0]) - reference)
    near_steel = _near_steel(time, np.hypot(*vector.T), off, moving)
    usable = np.abs(off[moving & ~near_steel])
    std = max(1.4826 * float(np.median(usable)), MIN_STD) if len(usable) else np.inf
    if std > MAX_HEADING_STD:
        raise InputError(_UNLIKE)
    turn = _turn(calibration, recipe.declination_deg)
    heading, known = _at(drive.gps.time - late, time, vector, near_steel)
    say(_in_words(calibration, recipe.declination_deg))
    when = (
        f" Each heading is measured {late:.2f} s before the time of its fix, since the fixes have this delay."
        if late
        else ""
    )
    none = f"{np.count_nonzero(~known)} of {len(known)} fixes have no heading (steel nearby, or no sample)"
    say(f"mag: the headings have a standard deviation of {np.degrees(std):.1f} deg.{when} {none}")
    heading = np.where(known, wrap_angle(heading + turn), 0.0)
    return replace(
        drive, gps=replace(drive.gps, heading=heading, std_heading=np.where(known, std, NO_HEADING))
    )


def _in_vehicle(values: Values, mount: str) -> Array:
    """Return the field (n, 2), forward and left; the calibration later corrects a constant tilt."""
    rotation = parse_mount(mount) if mount else np.eye(3)
    if "mz" not in values and np.any(rotation[:2, 2]):
        raise InputError("mag: the mounting needs mz; map mz, as in --map mag.mz=mag_z")
    axes = [values[name] for name in ("mx", "my", "mz") if name in values]
    return np.column_stack(axes) @ rotation[:2, : len(axes)].T


def _reference(evidence: Evidence, time: Array, late: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the gyro's heading, rad, corrected by the course, and a mask of motion, at times (n,), s."""
    course, yaw, imu = evidence.course, evidence.yaw, evidence.drive.imu
    if course is None or not course.moving.any() or not yaw.known:
        raise InputError(
            "mag: the calibration needs a moving vehicle and a gyro that follows the course of the fixes; correct the "
            "IMU, import another drive, or omit the magnetometer"
        )
    angle = integral(imu.time, yaw.factor * getattr(imu, yaw.column))
    seen, moving = course.time + evidence.moved - late, course.moving
    at = seen[moving]
    drift = np.exp(1j * (course.angle[moving] - smoothed(imu.time, angle, at, course.span)))
    rows = ((at - at[0]) // DRIFT_TIME).astype(np.int64)
    _, rows = np.unique(rows, return_inverse=True)
    count = np.bincount(rows)
    sums = np.bincount(rows, drift.real) + 1j * np.bincount(rows, drift.imag)
    known = np.bincount(rows, at) / count, np.unwrap(np.angle(sums))
    inside = (time >= imu.time[0]) & (time <= imu.time[-1])
    moves = np.interp(time, seen, moving.astype(np.float64), left=0.0, right=0.0) == 1.0
    return np.interp(time, imu.time, angle) + np.interp(time, *known), inside & moves


def _turned(heading: Array) -> int:
    """Return how many degrees of the circle the headings (n,), rad, cover."""
    bins = (np.degrees(heading) % 360 // BIN).astype(np.int64)
    return int(np.count_nonzero(np.bincount(bins, minlength=1) >= MIN_SAMPLES)) * BIN


def calibrate(heading: Array, field: Array) -> Calibration:
    """Fit the ellipse of a field (n, 2) to the heading (n,), rad, by least squares with Cauchy weights."""
    rows = slice(None, None, -(-len(heading) // MAX_ROWS))
    heading, field = heading[rows], field[rows]
    columns = np.column_stack([np.ones(len(heading)), np.cos(heading), np.sin(heading)])
    weight: Array = np.ones(len(heading))
    solution: Array = np.zeros((3, 2))
    for _ in range(30):
        root = np.sqrt(weight)[:, None]
        solution = np.asarray(np.linalg.lstsq(root * columns, root * field, rcond=None)[0], np.float64)
        size = np.hypot(*(field - columns @ solution).T)
        weight = 1 / (1 + (size / max(2 * float(np.median(size)), 1e-12)) ** 2)
    if np.linalg.cond(solution[1:]) > 100:
        raise InputError(_UNLIKE)
    return Calibration(solution[0], solution[1:].T)


def _near_steel(time: Array, size: Array, off: Array, moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark samples (n,) close in time to a field of unusual magnitude or unusual direction relative to the heading."""
    odd = _odd(size / float(np.median(size[moving])), moving) | (moving & _odd(off, moving))
    wrong = time[odd]
    return np.searchsorted(wrong, time - MARGIN) < np.searchsorted(wrong, time + MARGIN, side="right")


def _odd(values: Array, moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark values (n,) that differ by more than `MAX_FIELD_DEVIATION` from their median during motion."""
    apart = np.abs(values - float(np.median(values[moving])))
    deviations, least = MAX_FIELD_DEVIATION
    return apart > max(deviations * 1.4826 * float(np.median(apart[moving])), least)


def _at(
    fixes: Array, time: Array, vector: Array, near_steel: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the heading (m,), rad, at the times of fixes (m,), s, and a mask of known headings."""
    x, y = (np.interp(fixes, time, column) for column in vector.T)
    after = np.clip(np.searchsorted(time, fixes), 1, len(time) - 1)
    close = (time[after] - time[after - 1] <= MAX_GAP) & (fixes >= time[0]) & (fixes <= time[-1])
    return np.arctan2(y, x), close & ~near_steel[after] & ~near_steel[after - 1]


def _turn(calibration: Calibration, stated: float | None) -> float:
    """Return the correction, rad, of headings calibrated with the course that a stated declination, deg, requires."""
    if stated is None:
        return 0.0
    if not abs(stated) <= 180:
        raise InputError(
            f"--declination {stated:g} is out of range; specify -180 to 180 degrees, east positive"
        )
    if calibration.mirrored:
        raise InputError(
            "mag: mx and my rotate in the wrong direction, so --declination can't be applied; change the sign "
            "of mx or my, exchange mx and my, or omit --declination"
        )
    return calibration.declination - float(np.radians(stated))


def _in_words(calibration: Calibration, stated: float | None) -> str:
    x, y = calibration.center
    fitted = f"mag: hard iron {x:.4g}, {y:.4g}, soft iron {calibration.soft_iron:.1%}"
    if calibration.mirrored:
        return (
            f"{fitted}. The course shows that mx and my rotate in the wrong direction for x forward and y left; the "
            "import corrects the heading"
        )
    shown = f"shows {np.degrees(calibration.declination):+.1f} deg for the sum of declination and"
    stating = "" if stated is None else f"; the stated declination is {stated:+.1f} deg"
    return f"{fitted}{stating}. The course of the fixes {shown} the sensor's rotation about z"
