"""Check the wheel speed against fixes and accelerometer: sign, unit, scale, clock, stuck readings, slip."""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.receiver import UNITS
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import integral
from sigmaswarm.drives.drive import Odometer

# s, bounds of the duration of compared paths, which is a tenth of the drive's duration. Longer paths are less sensitive
# to noise, and the gyro's bias has little effect within 20 s.
SPAN_LIMITS = (6.0, 20.0)
MIN_DISTANCE = 15.0  # m, shortest straight distance of a compared path
MIN_PATHS = 6  # smallest number of readings, and of compared paths
MIN_SCALE_ERROR = 0.02  # smallest reported error of the scale; it must also exceed three standard deviations
# Ratio of the speeds, or its inverse, above which the unit is wrong rather than the tire size
MAX_SCALE_RATIO = 1.25

MIN_DELAY = 0.15  # s, smallest delay for a warning
MAX_LAG = 3.0  # s, largest tried delay
STEP = 0.02  # s, step of the tried delays
AVERAGING_TIME = 0.4  # s, over which the accelerations of odometer and IMU are averaged
TUNED_SCALES = (0.9, 1.1)  # bounds of the scale that `tune` tries with the option odometer
MAX_TUNED_LATENCY = 0.3  # s, largest latency that `tune` tries with this option; the smallest is 0
MIN_CORRELATION = 0.6  # smallest correlation of the accelerations at a delay

MIN_STUCK_TIME = 4.0  # s, shortest constant reading that counts as stuck
MIN_STUCK_ERROR = 2.5  # m/s, smallest median difference of a stuck reading from the fixes

# m/s, change of speed within MAX_JUMP_TIME s, without acceleration, that shows spinning or locked wheels. A slope of
# 10% looks like a change of 1 m/s, and a delay of 0.3 s during full braking looks like a change of 2 m/s.
MIN_JUMP = 2.5
MAX_JUMP_TIME = 1.0  # s, longest jump of the wheel speed
MAX_SLIP_TIME = 10.0  # s, longest time from a jump to the jump back
# m/s, largest median difference between the speed changes of odometer and IMU with which slip can be checked
MAX_DIFFERENCE = 0.5

Spans = list[tuple[float, float]]  # start and end, s
SPEED = "odometer.csv, speed"


def check_odometer(evidence: Evidence) -> Iterator[Finding]:
    odometer, course = evidence.drive.odometer, evidence.course
    if odometer is None or course is None or not course.moving.any() or len(odometer) < MIN_PATHS:
        return
    for code, confidence, fault, find in (
        ("stuck", 0.95, "the reading is constant while the fixes move at another speed", _stuck),
        ("slip", 0.9, "the wheel speed jumps without acceleration, so the wheels spin or lock", _slips),
    ):
        if spans := find(odometer, course, evidence):
            named = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in spans[:3]) + " ..." * (len(spans) > 3)
            repair = Repair("drop-readings", tuple(t for span in spans for t in span))
            span, remedy = (spans[0][0], spans[-1][1]), "omit these readings"
            what = f"{fault}: t = {named}"
            yield Finding(f"odometer-{code}", "warning", what, SPEED, span, confidence, remedy, repair)
            odometer = without_spans(odometer, spans)
            if len(odometer) < MIN_PATHS:
                return
    yield from _scale(odometer, course, evidence)
    yield from _clock(odometer, evidence)


def without_spans(odometer: Odometer, spans: Iterable[tuple[float, float]]) -> Odometer:
    keep = np.ones(len(odometer), dtype=np.bool_)
    for first, last in spans:
        keep &= (odometer.time < first) | (odometer.time > last)
    return odometer.select(keep)


def _stuck(odometer: Odometer, course: Course, _: Evidence) -> Spans:
    """Return spans of constant readings that contradict the fixes for any sign, unit and scale."""
    time, speed, seen = odometer.time, np.abs(odometer.speed), np.abs(course.velocity)
    begins = np.flatnonzero(np.append(True, np.diff(odometer.speed) != 0))
    ends = np.append(begins[1:], len(time)) - 1
    wheels = np.interp(course.time, time, speed)[course.moving]
    usual = float(np.median(seen[course.moving])) / max(float(np.median(wheels)), 1e-3)
    factor = usual if not 1 / MAX_SCALE_RATIO < usual < MAX_SCALE_RATIO else 1.0
    long = time[ends] - time[begins] >= MIN_STUCK_TIME
    found: Spans = []
    for a, b in zip(begins[long], ends[long], strict=True):
        inside = seen[(course.time >= time[a]) & (course.time <= time[b])]
        stuck = speed[a] * factor if speed[a] > 0 else 0.0
        if len(inside) >= 3 and np.median(np.abs(inside - stuck)) > MIN_STUCK_ERROR:
            found.append((float(time[a]), float(time[b])))
    return found


def _slips(odometer: Odometer, _: Course, evidence: Evidence) -> Spans:
    """Return spans in which the wheels spin or lock: from a jump of the speed to the jump back, or around a jump."""
    imu, time = evidence.drive.imu, odometer.time
    a, b = max(imu.time[0], time[0]) + MAX_JUMP_TIME, min(imu.time[-1], time[-1]) - MAX_JUMP_TIME
    at = np.arange(a, b, max(0.1, (b - a) / 1_000_000)) if b > a else np.zeros(0)
    ends = np.searchsorted(time, [at - MAX_JUMP_TIME / 2, at + MAX_JUMP_TIME / 2])
    at = at[(ends[1] - ends[0] >= 3) & (np.interp(at, time[1:], np.diff(time)) < MAX_JUMP_TIME / 2)]
    if len(at) < 100:
        return []
    apart = _gain(time, odometer.speed, at, MAX_JUMP_TIME)
    apart -= _gain(imu.time, integral(imu.time, imu.ax), at, MAX_JUMP_TIME)
    apart -= np.median(apart)
    quiet = np.abs(apart) < MIN_JUMP
    if np.median(np.abs(apart)) > MAX_DIFFERENCE or np.count_nonzero(quiet) < 0.5 * len(at):
        return []
    jumps: list[tuple[float, float]] = []  # time and size of each jump
    for jump in zip(at[~quiet].tolist(), apart[~quiet].tolist(), strict=True):
        if jumps and jump[0] - jumps[-1][0] <= MAX_JUMP_TIME and jump[1] * jumps[-1][1] > 0:
            jumps[-1] = max(jumps[-1], jump, key=lambda jump: abs(jump[1]))
        else:
            jumps.append(jump)
    found: Spans = []
    begun = -math.inf, 0.0
    for t, by in jumps:
        if by * begun[1] < 0 and t - begun[0] < MAX_SLIP_TIME:
            found[-1] = (found[-1][0], t + MAX_JUMP_TIME)
            begun = -math.inf, 0.0
        else:
            found.append((t - MAX_JUMP_TIME, t + MAX_JUMP_TIME))
            begun = t, by
    return found


def _gain(time: Array, values: Array, at: Array, span: float) -> Array:
    return np.interp(at + span / 2, time, values) - np.interp(at - span / 2, time, values)


def _scale(odometer: Odometer, course: Course, evidence: Evidence) -> Iterator[Finding]:
    found, span = _ratios(odometer, course, evidence), evidence.span
    if len(found) < MIN_PATHS:
        return
    ratio, chord = np.array(found).T
    scale = float(np.median(ratio))
    spread = max(
        1.4826 * float(np.median(np.abs(ratio - scale))),
        math.sqrt(2) * evidence.noise / float(np.median(chord)),
    )
    unsure = 1.2533 * spread / math.sqrt(len(ratio))
    size = abs(scale)
    if scale < 0 and unsure < 0.1 * size:
        what, repair = "the wheel speed is negative while the car drives forward", Repair("odometer", (-1.0,))
        remedy = "change the sign of speed: forward is positive"
        yield Finding("odometer-sign", "serious", what, SPEED, span, 0.99, remedy, repair)
        scale = size
    if scale <= 0:
        return
    for unit, factor in UNITS.items():
        if not 1 / MAX_SCALE_RATIO < size < MAX_SCALE_RATIO and abs(math.log(size * factor)) < 0.1:
            what = f"speed is in {unit}: its values are {size:.2f} times the speed of the fixes in m/s"
            remedy, repair = f"multiply speed by {factor:.4g}", Repair("odometer", (factor,))
            yield Finding("odometer-unit", "serious", what, SPEED, span, 0.99, remedy, repair)
            return
    if size > 0.1 and abs(size - 1) > max(MIN_SCALE_ERROR, 3 * unsure):
        way = "higher" if size > 1 else "lower"
        what = (
            f"the speed of the odometer is {abs(size - 1):.1%} {way} than that of the fixes "
            f"(standard deviation {unsure:.1%})"
        )
        remedy = f"divide speed by {size:.4f}"
        if TUNED_SCALES[0] < size < TUNED_SCALES[1]:
            remedy += (
                ", or let tune estimate the scale: its default filter does so if all drives have an odometer"
            )
        yield Finding(
            "odometer-scale", "warning", what, SPEED, span, 0.95, remedy, Repair("odometer", (1 / size,))
        )


def _ratios(odometer: Odometer, course: Course, evidence: Evidence) -> list[tuple[float, float]]:
    """Return for each path the ratio of the odometer's to the fixes' displacement, and the fixes' displacement, m."""
    imu, time = evidence.drive.imu, odometer.time
    heading = np.interp(time, imu.time, integral(imu.time, evidence.yaw_rate))
    east, north = odometer.speed * np.cos(heading), odometer.speed * np.sin(heading)
    place = integral(time, east) + 1j * integral(time, north)
    along = integral(time, odometer.speed)
    span = float(np.clip((course.time[-1] - course.time[0]) / 10, *SPAN_LIMITS))
    found: list[tuple[float, float]] = []
    first = 0
    for i in range(1, len(course.time)):
        ends = course.time[[first, i]]
        length = float(ends[1] - ends[0])
        if length < span:
            continue
        inside = time[slice(*np.searchsorted(time, ends))]
        chord = float(abs(course.position[i] - course.position[first]))
        known = time[0] <= ends[0] and ends[1] <= time[-1] and len(inside) >= 3 and length < 2 * span
        if known and chord > MIN_DISTANCE and float(np.max(np.diff(inside))) < 1.0:
            way = float(abs(np.diff(np.interp(ends, time, place))[0]))
            ahead = float(np.diff(np.interp(ends, time, along))[0])
            if way > 0.5 * abs(ahead):  # the path has no U-turn
                found.append((math.copysign(way, ahead) / chord, chord))
        first = i
    return found


def _clock(odometer: Odometer, evidence: Evidence) -> Iterator[Finding]:
    imu = evidence.drive.imu
    a, b = max(imu.time[0], odometer.time[0]), min(imu.time[-1], odometer.time[-1])
    if b - a < 20.0 or b - a > 1e6:
        return
    at = np.arange(a + MAX_LAG + AVERAGING_TIME, b - MAX_LAG - AVERAGING_TIME, max(STEP, (b - a) / 200_000))
    if len(at) < 500:
        return
    lags = np.arange(-MAX_LAG, MAX_LAG + STEP / 2, STEP)
    by_imu = _quick(imu.time, integral(imu.time, imu.ax), at)
    alike = np.abs([_correlation(by_imu, _quick(odometer.time, odometer.speed, at + lag)) for lag in lags])
    best = int(np.argmax(alike))
    delay = float(lags[best])
    if abs(delay) >= MIN_DELAY and alike[best] > max(MIN_CORRELATION, float(alike[len(lags) // 2]) + 0.05):
        way = "lags" if delay > 0 else "leads"
        what = f"the wheel speed {way} the acceleration by {abs(delay):.2f} s"
        remedy = f"add {-delay:+.2f} s to the times of odometer.csv"
        if 0 < delay < MAX_TUNED_LATENCY:
            remedy += ", or let tune estimate the latency: its default filter does so if all drives have an odometer"
        repair = Repair("shift-odometer", (-delay,))
        yield Finding(
            "odometer-clock", "warning", what, "odometer.csv, t", evidence.span, 0.9, remedy, repair
        )


def _quick(time: Array, values: Array, at: Array) -> Array:
    """Return accelerations at given times minus their means over 10 s, which removes the effect of road slope on ax."""
    slope = _gain(time, values, at, AVERAGING_TIME) / AVERAGING_TIME
    n = max(3, min(len(slope) // 2, round(10.0 / STEP)))
    total = np.append(0.0, np.cumsum(slope))
    edges = np.arange(len(slope))
    low, high = np.maximum(edges - n // 2, 0), np.minimum(edges + n // 2 + 1, len(slope))
    return slope - (total[high] - total[low]) / (high - low)


def _correlation(a: Array, b: Array) -> float:
    # not a @ b: BLAS would use threads, whose synchronization takes ten times as long as the sum
    ab, aa, bb = (float(np.sum(p * q)) for p, q in ((a, b), (a, a), (b, b)))
    size = math.sqrt(aa * bb)
    return ab / size if size > 0 else 0.0
