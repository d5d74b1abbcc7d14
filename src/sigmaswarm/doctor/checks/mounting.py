"""Check the mounting of a six-axis IMU and its changes, mirrored fixes, and logs that begin in reverse."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import fit_acceleration
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of, split_command
from sigmaswarm.doctor.mounting import Mounting, angle_of, level_rotation, rotate_imu
from sigmaswarm.doctor.windows import Values, integral, smoothed
from sigmaswarm.drives.alignment import StartFailure, find_start
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.split import name_of_whole
from sigmaswarm.geodesy import roll_pitch_yaw

# Smallest change of gravity's direction if the IMU was moved: in rad, and in typical errors of a median. In fault-free
# drives with 20 s of hard maneuvers at one end, the change was up to 18 degrees.
MIN_MOVEMENT, MIN_MOVEMENT_RATIO = math.radians(22.0), 4.0
MIN_TURNED = math.radians(45.0)  # rad, smallest turn of the IMU about the vertical, see `find_turn`
MIN_PART = 20.0  # s, shortest part of a drive before or after such a turn
# Smallest coherence of measured and expected accelerations in each part, and smallest RMS acceleration of the vehicle,
# m/s2
MIN_COHERENCE, MIN_MOTION = 0.5, 0.4
# Below these limits, hills (RMS slope of 8%) or a few maneuvers can look like a turn of the IMU, so the path must also
# show the turn. The last limit is the ratio of the turn to its standard deviation, from blocks of BLOCK s: up to 3 with
# an MPU-6050 on a flat road, and above 7 for 80% of planted turns by 60 to 180 degrees.
CLEAR_COHERENCE, CLEAR_MOTION, CLEAR_SIGMAS, BLOCK = 0.7, 0.8, 7.0, 4.0
# Largest ratio of the residuals of the path's regression with the turn to those without the turn. In 6,200 parts (60 s)
# of drives without faults, the ratio was below 0.9 in one drive (0.84).
MAX_RESIDUAL_RATIO = 0.9
# Smallest change of the direction of acceleration, rad, that driving backward explains
BACKWARD = math.radians(150.0)
OR_BACKWARD = ", or the vehicle drives backward before or after this time"
# Largest relative deviation of the magnitude of the specific force from its median, for 90% of the intervals of 5 s. In
# drives it is up to 0.04; if az is in g and ax, ay in m/s2, it is 0.2 or more.
MAX_SIZE_CHANGE = 0.1
# rad; directions with a larger typical deviation from their median are not those of gravity
MAX_SCATTER = 0.5
MIN_DIFFERENCE = math.radians(0.5)  # smallest difference from the mounting of drive.toml that a note reports
WHERE = "imu.csv, ax, ay, az, gx, gy, gz"

# An IMU counts as handled in the first or last ENDS s of a log if its mean rate of tilting over half a second exceeds
# HANDLED rad/s (fault-free drives: below 0.2) and UNLIKE times the largest rate in the rest of the log.
ENDS, HANDLED, UNLIKE = 15.0, 0.5, 4.0
# A vehicle may change between forward and reverse at speeds below STANDS m/s and below OF_USUAL times the 90% quantile
# of its speed; the second limit is for slow robots.
STANDS, OF_USUAL = 1.0, 0.3
STEP = 2.0  # s, for changes of speed and the integral of ax
# Smallest slope of speed changes on the integral of ax that determines the direction: absolute, and in standard
# deviations before and after the change of direction. The forward direction is fitted to the part after it.
MIN_SLOPE, MIN_SLOPE_SIGMAS = 0.4, (3.0, 5.0)


def check_mirrored(evidence: Evidence) -> Iterator[Finding]:
    """Report mirrored fixes. The other checks use the corrected fixes."""
    if not evidence.mirrored:
        return
    drive, places = evidence.drive, "lat and lon" if evidence.drive.frame == "wgs84" else "x and y"
    first, second = places.split(" and ")
    sign = evidence.mirrored == "reversed"
    fault = f"{places} of the fixes are exchanged"
    if sign:
        fault = "longitudes or latitudes of the fixes lack a minus sign, or the IMU's axes form a left-handed system"
    what = (
        f"{fault}, so the track is mirrored relative to the IMU. Relative to the fixes, gz and ay have the wrong sign, "
        "but ax has the correct sign, and the z axis points up"
    )
    remedy = (
        f"if gz and ay have the correct signs, exchange {places}: "
        f'import with --map "gps.{first}=COLUMN_OF_{second.upper()}" "gps.{second}=COLUMN_OF_{first.upper()}"'
    )
    if sign:
        west = 'with --map "gps.lon=-(COLUMN_OF_LON)" if the drive was west of Greenwich'
        south = '"gps.lat=-(COLUMN_OF_LAT)" if it was south of the equator'
        signs = " ".join(f'"imu.{name}=-(COLUMN_OF_{name.upper()})"' for name in ("ay", "gx", "gz"))
        remedy = f"import {west}, {south}, or {signs} if the coordinates are correct and the IMU's axes are left-handed"
    # Otherwise there is no repair: the truth may be mirrored too, and the exchange changes the scale of degrees.
    repair = Repair("exchange-fixes", ()) if drive.frame == "enu" and drive.truth is None else None
    where = f"gps.csv, {first}, {second}"
    yield Finding("mirrored-fixes", "serious", what, where, evidence.span, 0.99, remedy, repair)


def check_mounting(evidence: Evidence) -> Iterator[Finding]:
    mounting = evidence.mounting
    moved = find_movement(evidence.drive)
    if change := moved or find_turn(evidence):
        time, angle = change
        seen = "gravity" if moved else "the vehicle's acceleration in ax and ay"
        backward = OR_BACKWARD if not moved and angle > BACKWARD else ""
        what = f"the IMU was moved at t = {time:.0f} s{backward}: the direction of {seen} changes by "
        what += f"{math.degrees(angle):.0f} deg"
        command = split_command(time)
        remedy = f"split the drive at this time: {command}. The two parts have different mountings"
        span = time, evidence.span[1]
        yield Finding(
            "mounting-changed", "serious", what, WHERE, span, 0.99, remedy, cut=round(time), command=command
        )
    elif mounting is not None and mounting.slip:
        degrees, (begin, end) = math.degrees(mounting.slip), evidence.span
        command = split_command((begin + end) / 2)
        what = f"the IMU slowly tilts relative to the vehicle, by {degrees:.0f} deg from the first to the last third"
        remedy = f"fasten the IMU and record again; a split reduces the change in each part: {command}"
        yield Finding("mounting-slips", "warning", what, WHERE, evidence.span, 0.95, remedy, command=command)
    elif mounting is not None and mounting.confidence != "no":
        yield from _rotation(evidence, mounting)


def _rotation(evidence: Evidence, mounting: Mounting) -> Iterator[Finding]:
    mount = ",".join(f"{degrees:g}" for degrees in roll_pitch_yaw(mounting.mount, 1))
    total, angle = float(np.linalg.norm(mounting.std)), angle_of(mounting.repair)
    sure = (
        f"The total standard deviation is {math.degrees(total):.1f} deg (confidence: {mounting.confidence})"
    )
    # The mounting is constant in a drive, and a part determines it less accurately than the whole drive.
    whole = name_of_whole(evidence.drive)
    if mounting.needed and (mounting.serious or not whole):
        given = ",".join(f"{degrees:g}" for degrees in evidence.drive.mounting or ())
        instead = f" instead of {given} (the new angles include this rotation)" if given else ""
        roll, pitch, yaw = roll_pitch_yaw(mounting.repair, 1)
        yield Finding(
            "mounting", "serious" if mounting.serious else "warning",
            f"the IMU is {'' if mounting.confidence == 'sure' else 'probably '}rotated relative to the vehicle: roll "
            f"{roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg. {sure}",
            WHERE, evidence.span, confidence_of(angle / total),
            f"rotate all six axes: import with --mount {mount}{instead}",
            Repair("rotate", tuple(mounting.repair.ravel().tolist())),
        )  # fmt: skip
    elif evidence.drive.mounting and (apart := angle_of(mounting.mount @ mounting.before.T)) > MIN_DIFFERENCE:
        what = (
            f"the log shows the mounting {mount} deg. {sure}. The mounting in drive.toml differs from it by "
        )
        what += f"{math.degrees(apart):.1f} deg. "
        less = "An estimate from a part of a drive is less accurate than one from the whole drive"
        what += f"{less}, so no repair is needed" if whole else "This difference needs no repair"
        remedy = (
            "keep the mounting in drive.toml if it was measured; otherwise import "
            f"{'the whole log ' * bool(whole)}with --mount {mount}"
        )
        yield Finding("mounting", "note", what, WHERE, evidence.span, confidence_of(apart / total), remedy)


def find_turn(evidence: Evidence) -> tuple[float, float] | None:
    """Find the time, s, at which the IMU was turned about the vertical, and the angle, rad; None if it was not turned.

    For a part of the drive, S is the sum of a conj(u). Here u = ax + i ay is the measured force and a is the
    acceleration of the vehicle, each minus its mean. The argument of S is the angle of the IMU about the vertical. The
    time of the turn maximizes the sum of |S| of the parts before and after it.
    """
    course, imu, yaw = evidence.course, evidence.drive.imu, evidence.yaw
    if course is None or not yaw.known:
        return None
    speed, at = np.abs(course.velocity), course.time - evidence.delay
    force, rate = (
        smoothed(imu.time, v, at, course.span) for v in (imu.ax + 1j * imu.ay, getattr(imu, yaw.column))
    )
    motion = np.gradient(speed, at) + 1j * speed * yaw.factor * rate
    used = course.moving & (at > imu.time[0]) & (at < imu.time[-1])
    at, u, a = at[used], force[used] - np.mean(force[used]), motion[used] - np.mean(motion[used])
    cuts = np.flatnonzero((at > at[:1] + MIN_PART) & (at < at[-1:] - MIN_PART))
    if not len(cuts):
        return None
    products = a * u.conj()
    totals = [np.cumsum(v) for v in (products, np.abs(a) ** 2, np.abs(u) ** 2)]
    cut = cuts[np.argmax(np.abs(totals[0][cuts]) + np.abs(totals[0][-1] - totals[0][cuts]))]
    before, after = ([v[cut] for v in totals], [v[-1] - v[cut] for v in totals])
    coherence = min(abs(s) / max(math.sqrt(abs(x * y)), 1e-9) for s, x, y in (before, after))
    rms = math.sqrt(min(abs(before[1]) / (cut + 1), abs(after[1]) / (len(at) - cut - 1)))
    time, angle = float(at[cut]), float(np.angle(after[0] * np.conj(before[0])))
    if coherence < MIN_COHERENCE or rms < MIN_MOTION or abs(angle) < MIN_TURNED:
        return None
    rows = max(round(BLOCK / float(np.median(np.diff(at)))), 1)
    std = math.hypot(*(_angle_std(part, rows) for part in (products[: cut + 1], products[cut + 1 :])))
    clear = coherence > CLEAR_COHERENCE and rms > CLEAR_MOTION and abs(angle) > CLEAR_SIGMAS * std
    return (time, abs(angle)) if clear or _path_shows(evidence, time, angle) else None


def _angle_std(products: Values, rows: int) -> float:
    """Return the standard deviation (rad) of the argument of a sum, by a jackknife over blocks of ``rows`` products."""
    blocks = np.array([block.sum() for block in np.array_split(products, max(len(products) // rows, 2))])
    off = np.angle((blocks.sum() - blocks) * np.conj(blocks.sum()))
    return math.sqrt((len(blocks) - 1) / len(blocks) * float(off @ off))


def _path_shows(evidence: Evidence, time: float, angle: float) -> bool:
    """Return True if a turn of the forces, rad, after a time, s, makes the IMU's path agree better with the fixes."""
    drive, course, fit = evidence.drive, evidence.course, evidence.acceleration
    if course is None or fit is None:
        return False
    force = (drive.imu.ax + 1j * drive.imu.ay) * np.exp(1j * angle * (drive.imu.time > time))
    turned = replace(drive, imu=replace(drive.imu, ax=force.real, ay=force.imag))
    new = fit_acceleration(turned, course, evidence.yaw_rate, np.array([fit.delay]))
    return new is not None and all(
        float(size(np.abs(new.residual))) < MAX_RESIDUAL_RATIO * float(size(np.abs(fit.residual)))
        for size in (np.median, np.linalg.norm)
    )


def find_movement(drive: Drive) -> tuple[float, float] | None:
    """Find the time, s, at which the IMU was moved, and the turn of gravity's direction, rad; None if it was not moved.

    The time minimizes the scatter of the directions of the specific force (averages over 5 s) about their
    medians before and after this time. The magnitude of the force must be constant in each part, as that of gravity
    is. Otherwise gravity was subtracted, or the unit of az differs from that of ax and ay.
    """
    imu = drive.imu
    if imu.az is None:
        return None
    times, mean = _means(imu.time, (imu.ax, imu.ay, imu.az), 5.0)
    size = np.linalg.norm(mean, axis=1, keepdims=True)
    direction = mean / np.maximum(size, 1e-9)
    least = 4  # windows on each side: 20 s
    if len(direction) < 2 * least:
        return None

    def spread(cut: int) -> float:
        return sum(float(np.abs(v - np.median(v, axis=0)).sum()) for v in (direction[:cut], direction[cut:]))

    cut = min(range(least, len(direction) - least + 1), key=spread)
    change = [np.abs(part / np.median(part) - 1) for part in (size[:cut], size[cut:])]
    if float(np.quantile(np.concatenate(change), 0.9)) > MAX_SIZE_CHANGE:
        return None
    parts = direction[:cut], direction[cut:]
    before, after = (np.median(part, axis=0) for part in parts)
    angle = float(np.arccos(np.clip(before @ after / np.linalg.norm(before) / np.linalg.norm(after), -1, 1)))
    off = np.concatenate([np.linalg.norm(p - m, axis=1) for p, m in zip(parts, (before, after), strict=True)])
    if float(np.median(off)) > MAX_SCATTER:
        return None
    noise = float(np.median(off)) / math.sqrt(min(len(part) for part in parts))
    return (float(times[cut]), angle) if angle > max(MIN_MOVEMENT, MIN_MOVEMENT_RATIO * noise) else None


def _means(time: Array, columns: Sequence[Array], step: float) -> tuple[Array, Array]:
    """Return the starts (n,) of intervals of ``step`` s that contain samples, and the means (n, k) of their samples."""
    edges = np.arange(time[0], time[-1], step)
    rows = np.searchsorted(time, edges)
    sums = np.array([np.append(0.0, np.cumsum(v)) for v in columns])
    counts = np.diff(rows)
    return edges[:-1][counts > 0], (np.diff(sums[:, rows], axis=1)[:, counts > 0] / counts[counts > 0]).T


def check_handled(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each end of a log at which the IMU, such as a phone, is in someone's hand."""
    first, last = evidence.span
    begin, end = find_steady_span(evidence.drive)
    what = "{} t = {:.1f} s, the IMU moves relative to the vehicle, for example in someone's hand"
    for word, edge, span in (("before", begin, (first, begin)), ("after", end, (end, last))):
        if span[0] < span[1]:
            repair = Repair("cut-ends", (begin, last) if edge == begin else (first, end))
            remedy = f"omit the samples and fixes {word} this time"
            if edge == begin and evidence.drive.heading is not None:
                remedy += ", and heading_deg of drive.toml, which refers to the first sample"
            yield Finding(
                "mounting-handled", "warning", what.format(word, edge), WHERE, span, 0.99, remedy, repair
            )


def find_steady_span(drive: Drive) -> tuple[float, float]:
    """Return the first and last time, s, of the part in which the IMU tilts no faster than a vehicle."""
    imu, step = drive.imu, 0.5
    first, last = float(imu.time[0]), float(imu.time[-1])
    if imu.az is None or imu.gx is None or imu.gy is None or last - first < 4 * ENDS:
        return first, last
    times, mean = _means(imu.time, (imu.ax, imu.ay, imu.az, imu.gx, imu.gy, imu.gz), step)
    up = np.median(mean[:, :3], axis=0)
    tilting = np.linalg.norm(np.cross(mean[:, 3:], up / max(float(np.linalg.norm(up)), 1e-9)), axis=1)
    early, late = times < first + ENDS, times + step > last - ENDS
    usual = float(np.max(tilting[~early & ~late], initial=0.0))
    limit = max(HANDLED, UNLIKE * usual) if np.linalg.norm(up) > GRAVITY / 2 else np.inf
    begin = float(times[early & (tilting > usual)].max()) + step if np.any(tilting[early] > limit) else first
    end = float(times[late & (tilting > usual)].min()) if np.any(tilting[late] > limit) else last
    return begin, end


def check_reverse(evidence: Evidence) -> Iterator[Finding]:
    """Find a log in which a filter would start in reverse and use the course as the heading.

    The forward direction in the leveled axes is that in which the force explains the changes of speed after the first
    part. It is fitted with both axes, since in turns the lateral force is far larger than the forward force. Reverse
    driving before the filter's start is harmless.
    """
    course, drive = evidence.course, evidence.drive
    if course is None or not evidence.drives:
        return
    start = find_start(drive)
    if isinstance(start, StartFailure) or drive.heading is not None or drive.gps.heading is not None:
        return
    imu = drive.imu if evidence.mounting is None else rotate_imu(drive.imu, level_rotation(drive.imu))
    gained = integral(imu.time, imu.ax + 1j * imu.ay)
    gained = smoothed(imu.time, gained, course.time - evidence.delay, course.span)
    speed = np.abs(course.velocity)
    moving = speed > min(STANDS, OF_USUAL * float(np.quantile(speed, 0.9)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], moving.astype(int), [0]])))
    runs = [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 5]
    step = max(round(STEP / course.interval), 1)
    runs = [run for run in runs if run.stop - run.start >= step + 4]
    changes = [(_change(speed[run], step), _change(gained[run], step)) for run in runs]
    if len(changes) < 2:
        return
    later = np.concatenate([y for y, _ in changes[1:]]).real.astype(np.float64)
    force = np.concatenate([x for _, x in changes[1:]]).view(np.float64).reshape(-1, 2)
    ahead, left = np.linalg.lstsq(force, later)[0].tolist()
    forward = np.exp(-1j * math.atan2(left, ahead))
    slopes = [_slope(y, np.asarray((x * forward).real, np.float64), step) for y, x in changes]
    shown = [(run, *slope) for run, slope in zip(runs, slopes, strict=True) if slope]
    if len(shown) < 2:
        return
    (first, slope, std), *rest = shown
    least, least_after = MIN_SLOPE_SIGMAS
    until = float(course.time[first.stop - 1])
    reverse = -slope > max(least * std, MIN_SLOPE)
    forward_after = any(s > max(least_after * sigma, MIN_SLOPE) for _, s, sigma in rest)
    if start.time < until + course.span and reverse and forward_after:
        what = (
            f"the car seems to drive in reverse until t = {until:.0f} s: in this part ax is positive while "
            "the speed falls"
        )
        command = split_command(until + 2)
        remedy = f"remove this part: {command}, and use the second part"
        span = evidence.span[0], until
        where, cut = "gps.csv, imu.csv, ax", round(until + 2)
        yield Finding("reverse-start", "serious", what, where, span, 0.99, remedy, cut=cut, command=command)


def _change(values: Values, step: int) -> Values:
    """Return the changes over ``step`` values, minus their mean."""
    change = values[step:] - values[:-step]
    return change - change.mean()


def _slope(y: Array, x: Array, step: int) -> tuple[float, float] | None:
    """Fit changes y to changes x over ``step`` values. Return the slope and its standard deviation, or None."""
    power = float(x @ x)
    if power < 1.0:
        return None
    slope = float(x @ y) / power
    return slope, float(np.sqrt(step * np.sum((x * (y - slope * x)) ** 2)) / power) + 1e-6
