"""Check clock offset, rates, gaps, pauses and repeated values."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.clocks import OFFSET_SIGMAS
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of, finding_of
from sigmaswarm.doctor.mounting import MIN_EXPLAINED
from sigmaswarm.doctor.truth import MIN_DELAY
from sigmaswarm.doctor.yaw_fit import MIN_GAIN_TURN
from sigmaswarm.drives.checks import GPS_GAP, IMU_GAP, GapSummary, gaps_in, outside_of, unshared_times
from sigmaswarm.drives.drive import Gps
from sigmaswarm.drives.sensors import motion_in_noise, white_noise

SERIOUS_OFFSET = 0.3  # s; larger clock offsets cause errors of meters
LEAP_SECONDS = 18.0  # s, GPS time minus UTC
MAX_LEAP_ERROR = 0.3  # s; an offset that differs by less consists of these seconds and the receiver's delay
MAX_TUNED_LATENCY = 0.5  # s, largest latency of the fixes that `tune` tries; the smallest is 0
MIN_IMU_RATE = 8.0  # Hz; at lower rates, turns are lost between samples
MAX_INTERVAL_RANGE = 0.5  # largest range of the middle 90% of the intervals, relative to their median
# if a larger fraction of the IMU samples is repeated, the sensor is slower than the log
MAX_REPEATED_SHARE = 0.2
LONG_GAP = 0.5  # s without IMU samples; in longer gaps, a filter's step is inaccurate
MIN_STALE_FIXES = 3
MAX_UNUSED_SHARE = 0.5  # largest share of fixes outside of the IMU's time span without a warning
# Smallest excess of an interval between fixes, in usual intervals, that shows missing fixes
MIN_EXCESS = 0.3
SPEED_WINDOW = 2.0  # s on each side of a gap in which the speed is measured
SIGMAS = 3.0  # standard deviations that distinguish a pause from a clock jump
VERIFIED_REPAIR = " if a filter then predicts the fixes more accurately, which doctor --fix checks"


def check_clock(evidence: Evidence) -> Iterator[Finding]:
    delay, std, span, fit = evidence.clock.delay, evidence.clock.std, evidence.span, evidence.yaw_fit
    way, where, size = "late" if delay > 0 else "early", "gps.csv, t", f"{abs(delay):.2f} s"
    moved = "fixes and truth" if evidence.truth_has_clock_of_fixes else "the fixes"
    correction = (
        f"{'subtract' if delay > 0 else 'add'} {{}} {'from' if delay > 0 else 'to'} the times of {moved}"
    )
    with_truth = float(evidence.truth_has_clock_of_fixes)
    if evidence.moved:
        what = f"gyro and course show that the fixes are {abs(delay):.1f} s {way} relative to the IMU"
        shift, remedy = -evidence.moved, correction.format(size)
        if _is_leap(delay, std):
            shift = -math.copysign(LEAP_SECONDS, delay)
            remedy = f"{correction.format('18 s')}, since GPS time is 18 s ahead of UTC"
        repair = Repair("shift-clock", (shift, with_truth))
        yield Finding("clock-offset", "serious", what, where, span, 0.999, remedy, repair)
    elif drift := evidence.clock_drift:
        percent, fast = 100 * abs(drift.rate), "slow" if drift.rate > 0 else "fast"
        what = (
            f"the IMU's clock is {percent:.3f}% {fast} relative to that of the fixes (standard deviation "
            f"{100 * drift.std:.3f}%): the delay of the fixes in turns changes by {drift.change:.2f} s over the drive"
        )
        factor, begin = 1 / (1 - drift.rate), float(evidence.drive.imu.time[0])
        remedy = f"multiply the times of IMU and odometer since the first IMU sample by {factor:.6f}"
        repair = Repair("stretch-imu", (factor, begin))
        confidence = confidence_of(drift.rate / drift.std)
        yield Finding("clock-drift", "serious", what, "imu.csv, t", span, confidence, remedy, repair)
    elif abs(delay) >= evidence.clock.least:
        # Changes of speed alone, as on a motorway, are not evidence for a repair.
        turns = fit is not None and fit.course_change > MIN_GAIN_TURN and fit.share > MIN_EXPLAINED
        clear = turns and abs(delay) > OFFSET_SIGMAS[1] * std
        grave = abs(delay) > max(SERIOUS_OFFSET, OFFSET_SIGMAS[2] * std)
        condition = ("" if grave else VERIFIED_REPAIR) if clear else " if other drives also show this offset"
        remedy = f"{correction.format(size)}{condition}"
        if 0 < delay < MAX_TUNED_LATENCY:
            remedy += (
                f". Alternatively, tune the delay ({_latency_option(evidence)}). The tuned delay is that with the "
                "lowest cost, so it may differ from this offset by a few standard deviations"
            )
        yield Finding(
            "clock-offset", ("serious" if grave else "warning") if clear else "note",
            f"the fixes {'are' if clear else 'may be'} {size} {way} relative to the IMU "
            f"(standard deviation {std:.2f} s)",
            where, span, confidence_of(delay / std),
            remedy,
            Repair("shift-fixes", (-delay, with_truth)) if clear else None,
        )  # fmt: skip
    elif evidence.drives:
        visible = evidence.clock.visible
        which = "no clock offset" if visible is None else f"only a clock offset above {visible:.2f} s"
        what = f"in this drive, {which} between IMU and GPS can be detected reliably"
        if interval := evidence.clock.interval:
            what += ". The estimated delay of the fixes is {:.2f} to {:.2f} s (95% interval)".format(
                *interval
            )
        remedy = "use a drive with turns, starts and stops to detect smaller offsets, or tune the delay "
        remedy += f"({_latency_option(evidence)})"
        yield Finding("unseen-clock", "note", what, where, span, 0.95, remedy)


def _latency_option(evidence: Evidence) -> str:
    """Return the default options and ``latency``, since --use replaces the defaults."""
    return f"tune --use {' '.join((*evidence.suggestion.use, 'latency'))}"


def _is_leap(delay: float, std: float) -> bool:
    return abs(abs(delay) - LEAP_SECONDS) < max(MAX_LEAP_ERROR, 3 * std)


def check_truth(evidence: Evidence) -> Iterator[Finding]:
    """Compare the clock of the truth with that of the fixes, after any correction of the clock of the fixes."""
    truth, known = evidence.drive.truth, evidence.truth_delay
    delay = round((known or 0.0) + evidence.moved, 2)
    if truth is None or known is None or evidence.truth_has_clock_of_fixes or abs(delay) < MIN_DELAY:
        return
    size, way = f"{abs(delay):.2f} s", "large" if delay > 0 else "small"
    what = f"the truth's times are {size} too {way}: after the correction, the velocities of truth and fixes agree"
    leap = " (GPS time is 18 s ahead of UTC)" if _is_leap(delay, 0.0) else ""
    remedy = f"{'subtract' if delay > 0 else 'add'} {size} {'from' if delay > 0 else 'to'} the truth's times{leap}, "
    remedy += f"or import the log with --truth-offset {-delay:.2f}"
    span, repair = (float(truth.time[0]), float(truth.time[-1])), Repair("shift-truth", (-delay,))
    yield Finding("truth-clock", "serious", what, "truth.csv, t", span, 0.99, remedy, repair)


def check_sampling(evidence: Evidence) -> Iterator[Finding]:
    imu, gps = evidence.drive.imu, evidence.drive.gps
    yield _rate("imu", "IMU samples", imu.time)
    yield _rate("gps", "fixes", gps.time)
    remedy = (
        "if the car maneuvered during a gap, split the drive there; otherwise no action is needed. A filter uses the "
        "mean of the samples around a gap, and increases the state's covariance"
    )
    yield from _gaps("imu", gaps_in(imu.time, IMU_GAP), remedy)
    remedy = "during this time a filter uses only the IMU; no action is needed if this is intended"
    yield from _gaps("gps", gaps_in(gps.time, GPS_GAP, imu.time), remedy)
    if remark := unshared_times(imu.time, gps.time):
        most = outside_of(imu.time, gps.time).mean() > MAX_UNUSED_SHARE
        severity = "warning" if most else "note"
        found = finding_of(remark, severity, _ends(imu.time), 1.0)
        # a receiver may record longer than the IMU, and the additional fixes have no effect
        yield replace(found, needs_action=remark.code != "gps-outside")
    yield from clock_jumps(imu.time, gps)
    same = np.append(False, (np.diff(imu.ax) == 0) & (np.diff(imu.ay) == 0) & (np.diff(imu.gz) == 0))
    if same.mean() > MAX_REPEATED_SHARE:
        share, fresh = 100 * same.mean(), (1 - same.mean()) / imu.interval
        what = (
            f"{share:.0f}% of the samples repeat the previous one, so the sensor measures about {fresh:.0f} "
            "times per second"
        )
        repair = Repair("drop-samples", tuple(imu.time[same].tolist()))
        where, remedy = "imu.csv, ax, ay, gz", "log only new samples"
        yield Finding("imu-repeats", "warning", what, where, _ends(imu.time), 0.99, remedy, repair)
    stale = gps.time[evidence.stale]
    if len(stale) >= MIN_STALE_FIXES:
        what = f"{len(stale)} fixes repeat the previous position to the last digit, although the car moves"
        remedy = "remove these fixes for other programs; the filters of sigmaswarm ignore them"
        repair = Repair("drop-fixes", tuple(stale.tolist()))
        yield Finding(
            "gps-repeats", "warning", what, "gps.csv, positions", _ends(stale), 0.99, remedy, repair
        )


def _rate(sensor: str, counted: str, time: Array) -> Finding:
    interval = np.diff(time)
    usual = float(np.median(interval))
    low, high = np.quantile(interval, [0.05, 0.95])
    what = f"there are {len(time)} {counted} at {1 / usual:.3g} Hz over {time[-1] - time[0]:.0f} s"
    if high - low > MAX_INTERVAL_RANGE * usual:
        what += f". The intervals are uneven: 90% of them are between {1e3 * low:.0f} and {1e3 * high:.0f} ms"
    severity, remedy = "note", "filters use the true intervals; no action is needed"
    if sensor == "imu" and usual > 1 / MIN_IMU_RATE:
        severity, remedy = "warning", "record at 25 Hz or more"
    return Finding(f"{sensor}-rate", severity, what, f"{sensor}.csv, t", _ends(time), 1.0, remedy)


def _gaps(sensor: str, gaps: GapSummary | None, remedy: str) -> Iterator[Finding]:
    if gaps:
        many = f"there are {gaps.count} gaps; the longest lasts" if gaps.count > 1 else "there is a gap of"
        what = f"{many} {gaps.length:.2g} s at t = {gaps.start:.1f} s (usual interval {gaps.usual:.3g} s)"
        severity = "warning" if sensor == "imu" and gaps.length > LONG_GAP else "note"
        span = gaps.start, gaps.start + gaps.length
        yield Finding(f"{sensor}-gap", severity, what, f"{sensor}.csv, t", span, 1.0, remedy)


def clock_jumps(imu: Array, gps: Gps) -> Iterator[Finding]:
    """Find intervals in which both IMU samples and fixes are missing: the logger paused, or its clock jumped."""
    interval, fix_interval = np.diff(imu), np.diff(gps.time)
    usual, fix_usual = float(np.median(interval)), float(np.median(fix_interval))
    for i in np.flatnonzero(interval > max(IMU_GAP[0] * usual, IMU_GAP[1])):
        j = int(np.searchsorted(gps.time, imu[i], side="right")) - 1
        if not 1 <= j < len(fix_interval):
            continue
        missed, fix_missed = float(interval[i]) - usual, float(fix_interval[j]) - fix_usual
        apart = abs(missed - fix_missed)
        if apart > 1.1 * fix_usual or fix_missed < MIN_EXCESS * fix_usual:
            continue
        passed, std = _time_passed(gps, j)
        code, severity, repair = "logger-pause", "note", None
        remedy = "no action is needed; you can split the drive at this time"
        if 0.5 * fix_missed < SIGMAS * std:
            what = "the logger paused, or its clock jumped"
            evidence = "The car's speed does not distinguish these cases"
        elif passed < fix_usual + 0.5 * fix_missed:
            what = "the logger's clock jumped"
            evidence = f"The car needs only {passed:.1f} s for the distance between the fixes before and after the jump"
            code, severity = "clock-jump", "warning"
            remedy = "subtract the jump from all later times in all files"
            # A jump can be closed only if both sensors have the full jump, since lost samples can't be restored.
            if apart < 0.5 * fix_usual and passed < fix_usual + SIGMAS * std:
                repair = Repair("close-jump", (float(imu[i]), missed))
        else:
            what, evidence = "the logger paused while the car drove on", ""
        what += f": for {missed:.2g} s after t = {imu[i]:.2f} s, IMU samples and fixes are missing"
        what += f". {evidence}" if evidence else ""
        span = float(imu[i]), float(imu[i + 1])
        yield Finding(code, severity, what, "imu.csv, gps.csv, t", span, 0.9, remedy, repair)


def _time_passed(gps: Gps, j: int) -> tuple[float, float]:
    """Estimate the time from fix j to the next fix, and its standard deviation, s, from the speeds before and after.

    Each speed is the slope of a line through the fixes of `SPEED_WINDOW` s. If the two speeds differ, any speed between
    them is possible.
    """
    position, time = gps.position, gps.time
    noise = max(white_noise(position), motion_in_noise(gps.interval))
    lines, variance = [], 0.0
    for at, side in (
        (time[j], (time <= time[j]) & (time >= time[j] - SPEED_WINDOW)),
        (time[j + 1], (time >= time[j + 1]) & (time <= time[j + 1] + SPEED_WINDOW)),
    ):
        if side.sum() < 2:
            return 0.0, np.inf
        columns = np.column_stack([np.ones(side.sum()), time[side] - at])
        lines.append(np.linalg.lstsq(columns, position[side], rcond=None)[0])
        variance += noise**2 * float(np.linalg.inv(columns.T @ columns)[0, 0])
    (start, before), (end, after) = lines
    speed = (before + after) / 2
    if speed == 0.0:
        return 0.0, np.inf
    along = (end - start) * np.conj(speed) / abs(speed)
    variance += (abs(after - before) / 4 * float(time[j + 1] - time[j])) ** 2
    return float(along.real / abs(speed)), float(np.sqrt(variance) / abs(speed))


def _ends(time: Array) -> tuple[float, float]:
    return float(time[0]), float(time[-1])
