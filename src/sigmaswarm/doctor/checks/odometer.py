"""The wheels' speed against fixes and accelerometer: sign, unit, scale, clock, a counter that is stuck, and slip."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.doctor.checks.velocity import UNITS
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.drives.drive import Array, Odometer

SPAN = (6.0, 20.0)
"""s: bounds of the length of the paths of fixes that are compared with the wheels', a tenth of the drive. Longer ones
are less sensitive to noise, and the gyro's bias matters little within 20 s."""
SHORTEST = 15.0
"""m: shortest straight distance of such a path."""
FEWEST = 6
"""Fewest such paths."""
WRONG = 0.02
"""Error of the scale that is reported, if it is three times its uncertainty."""
FAMILIAR = 1.25
"""A factor beyond which the unit is another one, not the tires."""

LATE = 0.15
"""s of delay worth a warning; less is found by a filter's own latency."""
LARGEST_LAG, STEP, SMOOTH = 3.0, 0.02, 0.4
"""s: largest delay, its step, and the time over which both accelerations are averaged."""
ALIKE = 0.6
"""Correlation of the two accelerations from which their delay is used."""

STUCK = 4.0
"""s with one and the same reading, while the fixes move at another speed, ..."""
APART = 2.5
"""... by so many m/s at the median."""

JUMP = 2.5
"""m/s: change of the wheel speed within `WITHIN` without acceleration: they spin or lock. A slope of 10% looks like
1 m/s, a delay of 0.3 s like 2 m/s in a full braking."""
WITHIN, LASTS_AT_MOST = 1.0, 10.0
"""s: duration of a jump, and time in which the wheels return from it."""
AGREE = 0.5
"""m/s: largest median difference at which the accelerometer can check the wheels."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about odometer.csv."""
    odometer, course = evidence.drive.odometer, evidence.course
    if odometer is None or course is None or not course.moving.any() or len(odometer) < FEWEST:
        return
    stuck = _stuck(odometer, course)
    if stuck:
        yield Finding(
            "odometer-stuck", "warning",
            f"the same reading again and again while the fixes move at another speed: t = {_named(stuck)}",
            "odometer.csv, speed", (stuck[0][0], stuck[-1][1]), 0.95, "leave these readings out",
            Repair("drop-readings", tuple(t for span in stuck for t in span)),
        )  # fmt: skip
        odometer = without(odometer, stuck)
        if len(odometer) < FEWEST:
            return
    if slips := _slips(odometer, evidence):
        yield Finding(
            "odometer-slip", "warning",
            "the wheels' speed jumps where the accelerometer feels nothing, as of wheels that spin or lock: "
            f"t = {_named(slips)}",
            "odometer.csv, speed", (slips[0][0], slips[-1][1]), 0.9, "leave these readings out",
            Repair("drop-readings", tuple(t for span in slips for t in span)),
        )  # fmt: skip
        odometer = without(odometer, slips)
        if len(odometer) < FEWEST:
            return
    yield from _scale(odometer, course, evidence)
    yield from _clock(odometer, evidence)


def _named(spans: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in spans[:3]) + (" ..." if len(spans) > 3 else "")


def without(odometer: Odometer, spans: Iterable[tuple[float, float]]) -> Odometer:
    """The readings that lie in none of the spans, from when to when, s."""
    keep = np.ones(len(odometer), dtype=np.bool_)
    for first, last in spans:
        keep &= (odometer.time < first) | (odometer.time > last)
    return odometer.select(keep)


def _stuck(odometer: Odometer, course: Course) -> list[tuple[float, float]]:
    """From when to when one reading is repeated that the fixes contradict, s; signs, units and scale aside."""
    time, speed = odometer.time, np.abs(odometer.speed)
    begins = np.flatnonzero(np.append(True, np.diff(odometer.speed) != 0))
    ends = np.append(begins[1:], len(time)) - 1
    seen = np.abs(course.velocity)
    told = np.interp(course.time, time, speed)
    usual = float(np.median(seen[course.moving])) / max(float(np.median(told[course.moving])), 1e-3)
    factor = usual if not 1 / FAMILIAR < usual < FAMILIAR else 1.0
    found: list[tuple[float, float]] = []
    for a, b in zip(begins, ends, strict=True):
        if time[b] - time[a] < STUCK:
            continue
        inside = (course.time >= time[a]) & (course.time <= time[b])
        if np.count_nonzero(inside) >= 3:
            apart = np.abs(seen[inside] - (speed[a] * factor if speed[a] > 0 else 0.0))
            if np.median(apart) > APART:
                found.append((float(time[a]), float(time[b])))
    return found


def _slips(odometer: Odometer, evidence: Evidence) -> list[tuple[float, float]]:
    """From when to when the wheels do not turn as the car moves, s: from a jump to the one back, or about the jump."""
    imu = evidence.drive.imu
    a, b = max(imu.time[0], odometer.time[0]) + WITHIN, min(imu.time[-1], odometer.time[-1]) - WITHIN
    at = np.arange(a, b, max(0.1, (b - a) / 1_000_000)) if b > a else np.zeros(0)
    ends = np.searchsorted(odometer.time, [at - WITHIN / 2, at + WITHIN / 2])
    at = at[
        (ends[1] - ends[0] >= 3) & (np.interp(at, odometer.time[1:], np.diff(odometer.time)) < WITHIN / 2)
    ]
    if len(at) < 100:
        return []
    low, high = at - WITHIN / 2, at + WITHIN / 2
    gained = _integral(imu.time, imu.ax)
    told = np.interp(high, odometer.time, odometer.speed) - np.interp(low, odometer.time, odometer.speed)
    apart = told - (np.interp(high, imu.time, gained) - np.interp(low, imu.time, gained))
    apart -= np.median(apart)
    quiet = np.abs(apart) < JUMP
    if np.median(np.abs(apart)) > AGREE or np.count_nonzero(quiet) < 0.5 * len(at):
        return []
    jumps: list[tuple[float, float]] = []  # when, and by how much
    for i in np.flatnonzero(~quiet):
        if jumps and at[i] - jumps[-1][0] <= WITHIN and apart[i] * jumps[-1][1] > 0:
            jumps[-1] = max(jumps[-1], (float(at[i]), float(apart[i])), key=lambda jump: abs(jump[1]))
        else:
            jumps.append((float(at[i]), float(apart[i])))
    found: list[tuple[float, float]] = []
    begun: tuple[float, float] | None = None
    for t, by in jumps:
        if begun and by * begun[1] < 0 and t - begun[0] < LASTS_AT_MOST:
            found[-1] = (found[-1][0], t + WITHIN)
            begun = None
        else:
            found.append((t - WITHIN, t + WITHIN))
            begun = (t, by)
    return found


def _scale(odometer: Odometer, course: Course, evidence: Evidence) -> Iterator[Finding]:
    """The ratio of the wheels' way to the fixes', over ways that are about straight."""
    ratio, chord = _ratios(odometer, course, evidence)
    if len(ratio) < FEWEST:
        return
    scale = float(np.median(ratio))
    each = max(
        1.4826 * float(np.median(np.abs(ratio - scale))),
        math.sqrt(2) * evidence.noise / float(np.median(chord)),
    )
    unsure = 1.2533 * each / math.sqrt(len(ratio))
    size, span = abs(scale), evidence.span
    if scale < 0 and unsure < 0.1 * size:
        yield Finding(
            "odometer-sign", "serious", "the wheels turn backwards while the car drives ahead", "odometer.csv, speed",
            span, 0.99, "change the sign of speed: forward is positive", Repair("odometer", (-1.0,)),
        )  # fmt: skip
        scale = size
    for unit, factor in UNITS.items():
        if scale > 0 and not 1 / FAMILIAR < size < FAMILIAR and abs(math.log(size * factor)) < 0.1:
            yield Finding(
                "odometer-unit", "serious", f"speed is in {unit}: {size:.2f} times what the fixes move at",
                "odometer.csv, speed", span, 0.99, f"multiply speed by {factor:.4g}", Repair("odometer", (factor,)),
            )  # fmt: skip
            return
    if scale > 0 and size > 0.1 and abs(size - 1) > max(WRONG, 3 * unsure):
        way = "more" if size > 1 else "less"
        yield Finding(
            "odometer-scale", "warning",
            f"the wheels tell {abs(size - 1):.1%} {way} than the fixes move (to {unsure:.1%})", "odometer.csv, speed",
            span, 0.95, f"divide speed by {size:.4f}, or let `tune --use odometer` find its scale",
            Repair("odometer", (1 / size,)),
        )  # fmt: skip


def _ratios(odometer: Odometer, course: Course, evidence: Evidence) -> tuple[Array, Array]:
    """The wheels' way, bent as the gyro says, over the fixes', and how far the latter went, m; as the crow flies."""
    imu = evidence.drive.imu
    rate = evidence.yaw.factor * getattr(imu, evidence.yaw.column)
    heading = np.interp(odometer.time, imu.time, _integral(imu.time, rate))
    east, north = odometer.speed * np.cos(heading), odometer.speed * np.sin(heading)
    place = _integral(odometer.time, east) + 1j * _integral(odometer.time, north)
    along = _integral(odometer.time, odometer.speed)
    span = float(np.clip((course.time[-1] - course.time[0]) / 10, *SPAN))
    found: list[tuple[float, float]] = []
    first = 0
    for i in range(1, len(course.time)):
        a, b = float(course.time[first]), float(course.time[i])
        if b - a < span:
            continue
        there = slice(*np.searchsorted(odometer.time, [a, b]))
        inside = odometer.time[there]
        chord = float(abs(course.position[i] - course.position[first]))
        known = odometer.time[0] <= a and b <= odometer.time[-1] and len(inside) >= 3 and b - a < 2 * span
        if known and chord > SHORTEST and _gap(inside) < 1.0:
            way = float(abs(np.diff(np.interp([a, b], odometer.time, place))[0]))
            ahead = float(np.diff(np.interp([a, b], odometer.time, along))[0])
            if way > 0.5 * abs(ahead):  # and no turn round
                found.append((math.copysign(way, ahead) / chord, chord))
        first = i
    ratio, chord = np.array(found).T if found else np.zeros((2, 0))
    return ratio, chord


def _gap(time: Array) -> float:
    return float(np.max(np.diff(time)))


def _integral(time: Array, values: Array) -> Array:
    steps = 0.5 * np.diff(time) * (values[1:] + values[:-1])
    return np.concatenate([np.zeros(1), np.cumsum(steps)])


def _clock(odometer: Odometer, evidence: Evidence) -> Iterator[Finding]:
    """The delay of the speed's changes against what the accelerometer feels forward."""
    imu = evidence.drive.imu
    a, b = max(imu.time[0], odometer.time[0]), min(imu.time[-1], odometer.time[-1])
    if b - a < 20.0 or b - a > 1e6:
        return
    at = np.arange(a + LARGEST_LAG + SMOOTH, b - LARGEST_LAG - SMOOTH, max(STEP, (b - a) / 200_000))
    if len(at) < 500:
        return
    gained = _integral(imu.time, imu.ax)
    felt = _slope(imu.time, gained, at)
    lags = np.arange(-LARGEST_LAG, LARGEST_LAG + STEP / 2, STEP)
    alike = np.array([_correlation(felt, _slope(odometer.time, odometer.speed, at + lag)) for lag in lags])
    best = int(np.argmax(np.abs(alike)))
    late, now = float(lags[best]), float(np.abs(alike[len(lags) // 2]))
    if abs(late) >= LATE and abs(alike[best]) > ALIKE and abs(alike[best]) > now + 0.05:
        way = "late" if late > 0 else "early"
        yield Finding(
            "odometer-clock", "warning",
            f"the wheels' speed changes {abs(late):.2f} s {way} for what the accelerometer feels",
            "odometer.csv, t", evidence.span, 0.9,
            f"add {-late:+.2f} s to its times, or let `tune --use odometer` find its latency",
            Repair("shift-odometer", (-late,)),
        )  # fmt: skip


def _slope(time: Array, values: Array, at: Array) -> Array:
    """Of values (n,) around moments, per s."""
    return (np.interp(at + SMOOTH / 2, time, values) - np.interp(at - SMOOTH / 2, time, values)) / SMOOTH


def _correlation(a: Array, b: Array) -> float:
    """Of what changes within seconds: a road's slope, which the accelerometer feels, lasts longer."""
    a, b = _quick(a), _quick(b)
    # not a @ b: of so many numbers BLAS makes work for threads, which wait for each other ten times as long as they add
    ab, aa, bb = (float(np.sum(p * q)) for p, q in ((a, b), (a, a), (b, b)))
    size = math.sqrt(aa * bb)
    return ab / size if size > 0 else 0.0


def _quick(values: NDArray[np.float64], seconds: float = 10.0) -> Array:
    n = max(3, min(len(values) // 2, round(seconds / STEP)))
    total = np.cumsum(np.concatenate([np.zeros(1), values]))
    edges = np.arange(len(values))
    low, high = np.maximum(edges - n // 2, 0), np.minimum(edges + n // 2 + 1, len(values))
    return values - (total[high] - total[low]) / (high - low)
