"""Check the gyro: column, sign, unit, scale and bias of the yaw rate; signs and columns of the roll and pitch rates.

Within half a second, the direction of the specific force in body axes rotates opposite to the body (g' = -w x g). The
car's acceleration also rotates this direction, but in the same sense as the lean of a body on springs. In a left turn,
the force points to the left, and the left side rises. Therefore the signs are also visible on flat roads. The scale is
visible only for the roll rate, after removal of the part that the lateral acceleration explains.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import gyro_drift
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import NO_ACTION, Finding, Repair, confidence_of
from sigmaswarm.doctor.windows import integral, moving_mean, smoothed
from sigmaswarm.doctor.yaw_fit import DEGREE, MIN_GAIN_ERROR, yaw_windows
from sigmaswarm.drives.checks import GRAVITY, IMPOSSIBLE_RATE, impossible_rate
from sigmaswarm.drives.tables import Mask

# rad, RMS change of the course within 20 s; smaller changes are due to swaying
MIN_SCALE_TURN = np.radians(1.0)
BIAS_LIMITS = (np.radians(0.1), np.radians(1.0))  # rad/s, for a note and for a warning

MEAN_WINDOW = 0.3  # s, over which the force is averaged
# s, interval of a change of the force's direction. A longer interval contains more of the car's acceleration, and a
# shorter interval more vibration. On seven recordings, every correct sign is significant by 9.5 standard deviations or
# more.
LAG = 0.5
# Smallest significance of a sign, in standard deviations; high, since neighboring changes share samples
MIN_SIGNIFICANCE = 7.0
MIN_SIGNIFICANCE_RATIO = 2.0  # smallest ratio of the significance of a column to that of the other column
OUTLIER_SIGMAS = 3.0  # standard deviations; larger changes are outliers

# s, intervals over which changes determine the scale of the roll rate. On eleven drives with a correct scale, the
# estimates were 0.96 to 2.1 for the first interval and 0.54 to 1.24 for the second.
SCALE_LAGS = (1.0, 2.0)
# Largest logarithm of an estimated scale; on flat roads, the lean of the body gives scales above 10
MAX_LOG_SCALE = 0.8
MAX_SCALE_ERROR = 0.25  # largest relative standard deviation of an estimated scale
MIN_SCALE_LEAD = 0.1  # smallest lead of one scale over another, in the logarithm

# Rate that changes the direction of the force: column (0: gx, 1: gy), sign, and significance in standard deviations
RateMatch = tuple[int, float, float]


def check_gyro(evidence: Evidence) -> Iterator[Finding]:
    yaw, fit, span = evidence.yaw, evidence.yaw_fit, evidence.span
    imu, course = evidence.drive.imu, evidence.course
    if fit is None or course is None or not yaw.known:
        if impossible_rate(imu.gz - np.median(imu.gz)):
            what = (
                f"the yaw rate gz exceeds {IMPOSSIBLE_RATE:g} rad/s, so it is probably in deg/s. The unit can't be "
                "confirmed from the course of the fixes"
            )
            remedy = "look up the unit; multiply gx, gy, gz by pi/180 if the unit is deg/s"
            yield Finding("gyro-unit", "warning", what, "imu.csv, gz", span, 0.9, remedy)
        return
    where, confidence = f"imu.csv, {yaw.column}", confidence_of(fit.gain / fit.std / 6 * 3)
    seen = (
        f"The course is {fit.gain:.3g} times the integral of {yaw.column} (standard deviation of the factor "
        f"{fit.std:.2g})"
    )
    column, unit = float("xyz".index(yaw.column[1])), abs(yaw.factor)
    alone = _only_yaw_is_wrong(evidence)
    columns = "gz" if alone else "gx, gy, gz"
    turns = "the turns of the car are {:.3g} times those that the gyro measures".format

    def found(code: str, what: str, remedy: str, *repair: float) -> Finding:
        what = f"{what}. {seen}"
        return Finding(code, "serious", what, where, span, confidence, remedy, Repair("gyro", repair))

    if yaw.column != "gz":
        what = f"column {yaw.column}, not gz, contains the car's yaw rate"
        yield found("gyro-axis", what, f"exchange columns {yaw.column} and gz", column, 1.0)
    if unit == DEGREE:
        right = "gz is in deg/s; gravity shows that gx and gy are in rad/s"
        what = right if alone else "the angular rates are in deg/s"
        yield found("gyro-unit", what, f"multiply {columns} by pi/180", 2.0, DEGREE, float(alone))
    elif unit != 1:
        what = f"{turns(unit)}{'; gravity shows that gx and gy are correct' if alone else ''}"
        yield found("gyro-scale", what, f"multiply {columns} by {unit:.3g}", 2.0, unit, float(alone))
    if yaw.factor < 0:
        what = "the yaw rate has the wrong sign: it must be positive in a left turn"
        yield found("gyro-sign", what, "change the sign of gz", 2.0, -1.0)
    off = fit.gain / yaw.factor - 1
    clear = fit.course_change > MIN_SCALE_TURN and fit.separates_delay
    clear &= abs(off) > max(MIN_GAIN_ERROR, 4 * fit.std / abs(yaw.factor))
    if clear and abs(_whole_gain(evidence) - 1) > MIN_GAIN_ERROR / 2:
        repair, remedy = Repair("gyro", (2.0, 1 + off, 1.0)), f"multiply gz by {1 + off:.3g}"
        yield Finding("gyro-scale", "warning", turns(1 + off), where, span, confidence_of(4), remedy, repair)
    bias = -gyro_drift(imu.time, course, evidence.yaw_rate, evidence.delay)
    if abs(bias) > BIAS_LIMITS[0]:
        severity = "warning" if abs(bias) > BIAS_LIMITS[1] else "note"
        what = f"the gyro's bias is about {np.degrees(bias):.2f} deg/s"
        model = evidence.suggestion.model
        remedy = f"{NO_ACTION}, since the default filter of tune (--model {model}) estimates the bias"
        yield Finding("gyro-bias", severity, what, where, span, 0.95, remedy, needs_action=False)


def _whole_gain(evidence: Evidence) -> float:
    """Return the ratio of the course's turns to the gyro's turns.

    The ratio is a least-squares fit, without a bias, to the turn from the first to the last fix of each window.
    (`fit_yaw` removes a straight line from each window, so little of the turn remains in steady circles, and lever arm
    and slip have the effect of a scale error.)
    """
    time, course, fit = evidence.drive.imu.time, evidence.course, evidence.yaw_fit
    assert course is not None and fit is not None
    ends = yaw_windows(course)[:, [0, -1]]
    total = integral(time, evidence.yaw_rate)
    measured = np.diff(smoothed(time, total, course.time - fit.delay, course.span)[ends])
    return float(np.sum(np.diff(course.angle[ends]) * measured) / max(np.sum(measured**2), 1e-12))


def _only_yaw_is_wrong(evidence: Evidence) -> bool:
    """Return True if the roll angles from gravity show that gx, unlike gz, has a correct scale."""
    course, unit = evidence.course, abs(evidence.yaw.factor)
    if course is None or unit == 1 or evidence.yaw.column != "gz":
        return False
    if (read := _force_and_rates(evidence)) is None:
        return False
    (force, rates), time = read, evidence.drive.imu.time
    at = course.time - (evidence.yaw_fit.delay if evidence.yaw_fit else 0.0)
    speed = np.interp(time, at, np.abs(course.velocity))
    change = np.interp(time, at, np.gradient(np.abs(course.velocity), course.time))
    moving = np.interp(time, at, course.moving) == 1
    for lag in SCALE_LAGS:
        fits = _regressions(time, force, rates, lag, (speed * rates[2], change), moving)
        scale, std = (abs(float(values[0])) for values in fits[0]) if fits else (0.0, 1.0)
        if std > MAX_SCALE_ERROR * scale:
            return False
        # In `rates`, gx has the factor of gz, so a scale of 1 shows that gx needs this factor.
        errors = abs(np.log(scale)), abs(np.log(scale * unit))
        if errors[1] > MAX_LOG_SCALE or errors[0] - errors[1] < MIN_SCALE_LEAD:
            return False
    return True


def check_tilt(evidence: Evidence) -> Iterator[Finding]:
    """Find faults of gx and gy, unless an axis is missing or gravity is not in az."""
    follows = _tilt_rates(evidence)
    if not follows or is_upside_down(evidence):
        return
    seen, span = [axis for axis in follows if axis], evidence.span
    if any(axis and axis[0] != right for right, axis in enumerate(follows)):
        if [axis[0] for axis in seen] != [1, 0]:
            return  # one rate alone, or both on one column: no exchange of axes explains this
        roll, pitch = (f"{'-' if sign < 0 else ''}{('gx', 'gy')[column]}" for column, sign, _ in seen)
        yield Finding(
            "gyro-tilt", "warning",
            f"the direction of gravity shows that the roll rate is in {roll} and the pitch rate in {pitch}",
            "imu.csv, gx, gy", span, confidence_of(min(axis[2] for axis in seen) / 2),
            f"use {roll} as gx and {pitch} as gy", Repair("tilt-rates", (0.0, seen[0][1], seen[1][1], 0.0)),
        )  # fmt: skip
        return
    if wrong := [axis for axis in seen if axis[1] < 0]:
        columns = [("gx", "gy")[axis[0]] for axis in wrong]
        names = " and ".join(columns)
        signs = [axis[1] if axis else 1.0 for axis in follows]
        yield Finding(
            "gyro-tilt", "warning",
            f"{names} {'have' if len(wrong) > 1 else 'has'} the wrong sign: gravity in ax, ay, az rotates in the "
            "opposite direction. The roll rate gx must be positive while the left side rises. The pitch rate gy must "
            "be positive while the nose sinks",
            f"imu.csv, {', '.join(columns)}", span, confidence_of(min(axis[2] for axis in wrong) / 2),
            f"change the sign of {names}", Repair("tilt-rates", (signs[0], 0.0, 0.0, signs[1])),
        )  # fmt: skip
    if unseen := [k for k, axis in enumerate(follows) if axis is None]:
        columns, motion = ([names[k] for k in unseen] for names in (("gx", "gy"), ("roll", "pitch")))
        what = (
            f"the specific force shows hardly any {' or '.join(motion)} of the body, so the sign of "
            f"{' and '.join(columns)} can't be checked"
        )
        remedy = "use a drive with turns, starts and stops to check the sign"
        yield Finding("unseen-tilt", "note", what, f"imu.csv, {', '.join(columns)}", span, 0.95, remedy)


def is_upside_down(evidence: Evidence) -> bool:
    """Return True if az, gx and gy show that the IMU is upside down, and the course can't confirm this."""
    imu, mount = evidence.drive.imu, evidence.mount
    if imu.az is None or float(np.median(imu.az)) > 0 or evidence.yaw.known:
        return False
    seen = [(column, axis) for column, axis in enumerate(_tilt_rates(evidence)) if axis]
    level = mount is None or np.array_equal(mount.axes, np.eye(2))
    return level and bool(seen) and all(axis[:2] == (column, -1.0) for column, axis in seen)


def _tilt_rates(evidence: Evidence) -> list[RateMatch | None]:
    """Find the rate that best explains the changes of the specific force's direction, for roll and for pitch.

    The rate is gx or gy with a sign, or None if it is not clear. The list is empty if a column or gravity is missing.
    """
    if (read := _force_and_rates(evidence)) is None:
        return []
    fits = _regressions(evidence.drive.imu.time, *read, LAG)
    roll, pitch = [factors / std for factors, std in fits] or [np.zeros(2), np.zeros(2)]
    return [_clear(roll), _clear(-pitch)]


def _force_and_rates(evidence: Evidence) -> tuple[Array, Array] | None:
    """Return the specific force and the angular rates, (3, n), corrected as the other findings propose."""
    imu, mount, yaw = evidence.drive.imu, evidence.mount, evidence.yaw
    if imu.az is None or imu.gx is None or imu.gy is None:
        return None
    level = (mount.matrix if mount is not None else np.eye(2)) @ np.array([imu.ax, imu.ay])
    up = float(np.median(np.abs(imu.az)))
    unit = GRAVITY if 0.8 < up < 1.2 else 1.0
    if not 0.7 * GRAVITY < unit * up < 1.3 * GRAVITY:
        return None
    force = np.array([*level, unit * np.sign(np.median(imu.az)) * imu.az])
    rates = {"gx": imu.gx, "gy": imu.gy, "gz": imu.gz}
    rates["gz"], rates[yaw.column] = rates[yaw.column], rates["gz"]
    unit = abs(yaw.factor)
    return force, np.array([unit * rates["gx"], unit * rates["gy"], yaw.factor * rates["gz"]])


def _regressions(
    time: Array,
    force: Array,
    rates: Array,
    lag: float,
    others: Sequence[Array] = (),
    used: Mask | None = None,
) -> list[tuple[Array, Array]]:
    """Fit the changes of the force's direction (y, x) within ``lag`` s to the turns about x and y.

    Return two coefficients and their standard deviations for y and for x; [] if there are too few samples. Other
    regressors are the turn about z, which changes the direction if the sensor is tilted or the car corners, and the
    changes of ``others`` (k, n). ``used`` (n,) marks samples between which changes are used, by default all.
    """
    interval = float(np.median(np.diff(time)))
    count, step = (max(round(seconds / interval), 1) for seconds in (MEAN_WINDOW, lag))
    first = np.arange(0, len(time) - step, max(step // 2, 1))
    first = first[time[first + step] - time[first] < 2 * lag]  # the rates within a gap are unknown
    first = first if used is None else first[used[first] & used[first + step]]
    if len(first) < 20:
        return []
    mean = moving_mean(force, count)
    direction = mean / np.maximum(np.linalg.norm(mean, axis=0), 0.1 * GRAVITY)
    seen = moving_mean(np.array([*(integral(time, rate) for rate in rates), *others]), count)
    change, turned = (values[:, first + step] - values[:, first] for values in (direction, seen))
    return [_robust_fit(turned, change[1]), _robust_fit(turned, change[0])]


def _robust_fit(regressors: Array, change: Array) -> tuple[Array, Array]:
    """Return the first two coefficients of a robust linear fit with a constant term, and their standard deviations."""
    columns = np.column_stack([*regressors, np.ones(len(change))])
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    columns = columns / scale
    factors, left, kept = np.zeros(len(scale)), np.zeros(len(change)), np.ones(len(change), dtype=np.bool_)
    for _ in range(3):
        # the first round keeps all
        kept = np.abs(left) <= OUTLIER_SIGMAS * float(np.median(np.abs(left))) / 0.6745 + 1e-9
        factors = np.asarray(np.linalg.lstsq(columns[kept], change[kept], rcond=None)[0], np.float64)
        left = change - columns @ factors
    covariance = np.linalg.pinv(columns[kept].T @ columns[kept]) * (np.var(left[kept]) + 1e-18)
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    return (factors / scale)[:2], (std / scale)[:2]


def _clear(deviations: Array) -> RateMatch | None:
    column = int(np.argmax(np.abs(deviations)))
    size, other = float(abs(deviations[column])), float(abs(deviations[1 - column]))
    if size < max(MIN_SIGNIFICANCE, MIN_SIGNIFICANCE_RATIO * other):
        return None
    return column, float(np.sign(deviations[column])), size
