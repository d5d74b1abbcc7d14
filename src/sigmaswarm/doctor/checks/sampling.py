"""Rates, gaps, values that only repeat."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.drives.checks import GPS_GAP, IMU_GAP, gaps_in
from sigmaswarm.drives.drive import Array, Gps, Imu
from sigmaswarm.drives.sensors import motion_in_noise, white_noise

SLOW_IMU = 8.0
"""Hz: slower, turns are lost between samples."""
UNEVEN = 0.5
"""Share of the usual interval that the middle 90% of the intervals spread over."""
HELD = 0.2
"""Share of IMU samples that repeat the one before: a slower sensor, logged too often."""
LONG_GAP = 0.5
"""s without IMU samples, after which a step is no longer harmless."""
FEWEST_STALE = 3
LEAST_MISSED = 0.3
"""Usual intervals of fixes by which one is longer if fixes are missing where IMU samples are."""
AROUND = 2.0
"""s on each side of a gap in which the speed is measured."""
SIGMAS = 3.0
"""By which a pause has to lie off a jump to be told from it, each from the middle between them."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about when samples came."""
    imu, gps = evidence.drive.imu, evidence.drive.gps
    yield _rate("imu", imu.time)
    yield _rate("gps", gps.time)
    yield from _gaps(
        "imu", imu.time, IMU_GAP,
        "a filter drives on by the mean of the samples around it, and grows unsure of what the car did meanwhile",
    )  # fmt: skip
    yield from _gaps(
        "gps", gps.time, GPS_GAP, "a filter runs on the IMU alone there; nothing to do if it was so meant"
    )
    yield from clock_jumps(imu.time, gps)
    yield from _held(imu)
    yield from _stale(evidence)


def _rate(sensor: str, time: Array) -> Finding:
    interval = np.diff(time)
    usual = float(np.median(interval))
    low, high = np.quantile(interval, [0.05, 0.95])
    counted = "samples" if sensor == "imu" else "fixes"
    what = f"{len(time)} {counted} at {1 / usual:.3g} Hz over {time[-1] - time[0]:.0f} s"
    uneven = high - low > UNEVEN * usual
    slow = sensor == "imu" and usual > 1 / SLOW_IMU
    if uneven:
        what += f", uneven: 9 of 10 intervals last {1e3 * low:.0f} to {1e3 * high:.0f} ms"
    remedy = "filters step by the true intervals; nothing to do" if not slow else "record at 25 Hz or more"
    return Finding(
        f"{sensor}-rate", "warning" if slow else "note", what, f"{sensor}.csv, t", _ends(time), 1.0, remedy
    )


def _gaps(sensor: str, time: Array, limit: tuple[float, float], remedy: str) -> Iterator[Finding]:
    gaps = gaps_in(time, limit)
    if gaps is None:
        return
    span = gaps.start, gaps.start + gaps.length
    many = f"{gaps.count} gaps, the longest" if gaps.count > 1 else "a gap of"
    what = f"{many} {gaps.length:.2g} s (usual interval {gaps.usual:.3g} s)"
    severity = "warning" if sensor == "imu" and gaps.length > LONG_GAP else "note"
    yield Finding(f"{sensor}-gap", severity, what, f"{sensor}.csv, t", span, 1.0, remedy)


def clock_jumps(imu: Array, gps: Gps) -> Iterator[Finding]:
    """Moments that both sensors miss alike: the logger paused, or its clock jumped while the car did not."""
    interval, fix_interval = np.diff(imu), np.diff(gps.time)
    usual, fix_usual = float(np.median(interval)), float(np.median(fix_interval))
    for i in np.flatnonzero(interval > max(IMU_GAP[0] * usual, IMU_GAP[1])):
        j = int(np.searchsorted(gps.time, imu[i], side="right")) - 1
        if not 1 <= j < len(fix_interval):
            continue
        missed, fix_missed = float(interval[i]) - usual, float(fix_interval[j]) - fix_usual
        if abs(missed - fix_missed) > 1.1 * fix_usual or fix_missed < LEAST_MISSED * fix_usual:
            continue
        passed, std = _time_passed(gps, j)
        unsure = 0.5 * fix_missed < SIGMAS * std
        jumped = not unsure and passed < fix_usual + 0.5 * fix_missed
        # What else was lost with the jump nobody can put back: closed is what both clocks miss alike, and all of it.
        whole = abs(missed - fix_missed) < 0.5 * fix_usual and passed < fix_usual + SIGMAS * std
        if unsure:
            what = "the logger paused, or its clock jumped: the car's speed around it can't tell"
        elif jumped:
            what = f"the logger's clock jumped: the car went as far between these fixes as in {passed:.1f} s"
        else:
            what = "the logger paused: the car drove on"
        yield Finding(
            "clock-jump" if jumped else "logger-pause",
            "warning" if jumped else "note",
            f"IMU and fixes both miss {missed:.2g} s after t = {imu[i]:.2f} s: {what}",
            "imu.csv, gps.csv, t",
            (float(imu[i]), float(imu[i + 1])),
            0.9,
            "take the jump off all later times of all files"
            if jumped
            else "nothing to do, or split the drive there",
            Repair("close-jump", (float(imu[i]), missed)) if jumped and whole else None,
        )


def _time_passed(gps: Gps, j: int) -> tuple[float, float]:
    """How long the car was on its way from fix j to the next at the speed around them, s; and its standard deviation.

    By a line through the fixes of `AROUND` seconds on each side: one fix more or less off says nothing. Where the two
    sides' speeds differ, the car may have gone at either of them.
    """
    position, time = gps.x + 1j * gps.y, gps.time
    noise = max(white_noise(position), motion_in_noise(float(np.median(np.diff(time)))))
    before = (time <= time[j]) & (time >= time[j] - AROUND)
    after = (time >= time[j + 1]) & (time <= time[j + 1] + AROUND)
    if min(before.sum(), after.sum()) < 2:
        return 0.0, np.inf
    ends, speeds, variance = [], [], 0.0
    for side, at in ((before, time[j]), (after, time[j + 1])):
        columns = np.column_stack([np.ones(side.sum()), time[side] - at])
        (end, speed), *_ = np.linalg.lstsq(columns, position[side], rcond=None)
        ends.append(end)
        speeds.append(speed)
        variance += noise**2 * float(np.linalg.inv(columns.T @ columns)[0, 0])
    speed = (speeds[0] + speeds[1]) / 2
    if speed == 0.0:
        return 0.0, np.inf
    along = (ends[1] - ends[0]) * np.conj(speed) / abs(speed)
    variance += (abs(speeds[1] - speeds[0]) / 4 * float(time[j + 1] - time[j])) ** 2
    return float(along.real / abs(speed)), float(np.sqrt(variance) / abs(speed))


def _held(imu: Imu) -> Iterator[Finding]:
    """Find samples that repeat all values, which a filter would count several times."""
    same = np.append(False, (np.diff(imu.ax) == 0) & (np.diff(imu.ay) == 0) & (np.diff(imu.gz) == 0))
    if same.mean() > HELD:
        share, fresh = 100 * same.mean(), (1 - same.mean()) / float(np.median(np.diff(imu.time)))
        yield Finding(
            "imu-repeats",
            "warning",
            f"{share:.0f}% of the samples repeat the one before: the sensor gives about {fresh:.0f} a second",
            "imu.csv, ax, ay, gz",
            _ends(imu.time),
            0.99,
            "log only fresh samples",
            Repair("drop-samples", tuple(imu.time[same].tolist())),
        )


def _stale(evidence: Evidence) -> Iterator[Finding]:
    time = evidence.drive.gps.time[evidence.stale]
    if len(time) >= FEWEST_STALE:
        yield Finding(
            "gps-repeats",
            "warning",
            f"{len(time)} fixes repeat the one before to the last digit while the car drives",
            "gps.csv, positions",
            _ends(time),
            0.99,
            "filters leave them out, as other tools should: they are old positions under a new time",
            Repair("drop-fixes", tuple(time.tolist())),
        )


def _ends(time: Array) -> tuple[float, float]:
    return float(time[0]), float(time[-1])
