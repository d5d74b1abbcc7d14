"""Assemble a drive from joined columns, on one clock and in one frame."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.checks import shortage_of
from sigmaswarm.drives.drive import Drive, Gps, Imu, Odometer, Truth
from sigmaswarm.drives.mounting import AXES_KEY, with_rotation
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import Origin, wrap_angle
from sigmaswarm.importing.dates import GPS_EPOCH, MIN_DATE, SECOND, WEEK, Nanoseconds, gps_to_unix
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.joining import join, without_column
from sigmaswarm.importing.mounting import parse_mount, rotate
from sigmaswarm.importing.positions import (
    MAX_SPEED,
    MIN_SPEED,
    Say,
    Values,
    add_local_position,
    chord_course,
    coarse_degrees,
    fitting_angle,
)
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.shared_frame import assumed_origin, require_same_axes
from sigmaswarm.importing.source import ROLES, Role
from sigmaswarm.importing.time_units import FASTEST_IMU, MAX_STEP, MIN_FIX_INTERVAL, SLOWEST_IMU
from sigmaswarm.importing.timeline import DECIMAL_PERIODS, MINUTE, STEPS, wraps_too_fast
from sigmaswarm.importing.velocities import without_wrong_velocity
from sigmaswarm.wording import printable, rows_left_out

SEED = 0  # seed of the noise of fixes made from the truth
MAX_FIXES = 10_000_000  # largest number of such fixes
REQUIRED: Mapping[Role, tuple[str, ...]] = {"imu": ("ax", "ay", "gz"), "odometer": ("speed",)}
WITHOUT_POSITION = "gps: no column contains a position; map lat and lon (deg), or x and y (m east, north)"


@np.errstate(all="ignore")  # infinite values are refused when the drive is read back
def assemble(
    name: str,
    gathered: Mapping[Role, Sequence[PartColumns]],
    recipe: Recipe,
    say: Say,
    recording: int | None = None,
) -> Drive:
    """Make a drive from gathered columns; ``say`` receives sentences on assumptions and omissions.

    ``recording``: number of the recording to use, counted from 1, if a clock restarts within a table.
    """
    times: dict[Role, Nanoseconds] = {}
    values: dict[Role, Values] = {}
    for role, parts in gathered.items():
        times[role], values[role] = join(parts, role, REQUIRED.get(role, ()), say, recording)
    _report_other_clocks(times, gathered, say)
    seconds, zero = _seconds(_in_same_period(times, gathered, say), recipe)
    if gathered["imu"][0].set_ahead:
        _cut_to_recording(seconds, values, say)
    imu = _imu(seconds["imu"], values["imu"], recipe)
    origin = recipe.origin
    gps: Values = {}
    if "gps" in values:
        gps, origin = placed_fixes(values["gps"], origin, say, _texts(gathered["gps"]))
        _require_meters(seconds["gps"], gps, gathered["gps"])
        course, rows = chord_course(seconds["gps"], gps["x"], gps["y"])
        for angle in ("course", "heading"):
            if angle in gps:
                gps[angle] = fitting_angle(gps[angle], course, rows, f"gps: the {angle}", say)
        gps = without_wrong_velocity(seconds["gps"], gps, "gps", [g.part for g in gathered["gps"]], say)
    truth = None
    if "truth" in values:
        truth, origin = _truth(seconds, values["truth"], origin, gps, gathered["truth"], recipe, say)
    if recipe.gps_from_truth:
        if truth is None:
            raise InputError(
                f"{name}: --gps-from-truth needs truth, but the log contains none; add another log with --truth"
            )
        seconds["gps"], gps = _made_fixes(truth, *recipe.gps_from_truth)
    wheels = Odometer(seconds["odometer"], values["odometer"]["speed"]) if "odometer" in values else None
    drive = Drive(
        name=name,
        imu=imu,
        gps=Gps(seconds["gps"], **gps),
        truth=truth,
        frame="wgs84" if "lat" in gps else "enu",
        origin=origin,
        metadata=_metadata(recipe, zero),
        odometer=wheels,
    )
    coarse = coarse_degrees(gps)
    if shortage := shortage_of(drive.imu, drive.gps):
        shortage += f"; {coarse}" if coarse else ""
        if "overlap" in shortage:
            offset = drive.imu.time[0] - drive.gps.time[0]
            remedy = _as_digits(seconds, gathered) or ("" if zero else _one_clock(seconds, gathered))
            moves = "".join(f"--gps-offset {move:.10g} if {why}, or " for move, why in _moves(seconds, zero))
            shortage += (
                remedy or f": add {moves}--gps-offset {offset:.3f} if both logs began at the same time"
            )
        raise InputError(f"{name}: {shortage}")
    if coarse:
        say(f"gps: {coarse}")
    return drive


def _truth(
    seconds: Mapping[Role, Array],
    values: Values,
    origin: Origin | None,
    gps: Values,
    gathered: Sequence[PartColumns],
    recipe: Recipe,
    say: Say,
) -> tuple[Truth, Origin | None]:
    placed, origin = _placed_truth(values, origin, gps, _texts(gathered))
    parts = [g.part for g in gathered]
    message = require_same_axes(seconds, placed, gps, parts) if gps else ""
    assumed = "lat" in gps and "lat" not in placed and recipe.origin is None
    if assumed and origin is not None and not message:
        message = assumed_origin(seconds, placed, gps, origin)
    if message:
        say(message)
    if {"speed", "course"} <= placed.keys() or {"vx", "vy"} <= placed.keys():
        placed = without_wrong_velocity(seconds["truth"], placed, "truth", parts, say)
    return Truth(seconds["truth"], **_motion(seconds["truth"], placed, gps, say)), origin


def missing_columns(recipe: Recipe) -> Iterator[str]:
    there = {
        role: {name.removeprefix("+") for part in parts for name in part.columns}
        for role, parts in recipe.roles.items()
    }
    for role, required in REQUIRED.items():
        yield from (without_column(role, name) for name in required if name not in there.get(role, required))
    if "gps" in there and not any(pair <= there["gps"] for pair in ({"lat", "lon"}, {"x", "y"})):
        yield WITHOUT_POSITION


def _as_digits(seconds: Mapping[Role, Array], gathered: Mapping[Role, Sequence[PartColumns]]) -> str:
    """Return a remedy if the times of one table are digits hhmmss that were read as seconds; otherwise "".

    In this case the tables overlap in time only if the digits are converted to seconds.
    """
    pairs: tuple[tuple[Role, Role], ...] = (("gps", "imu"), ("imu", "gps"))
    for role, other in pairs:
        text = gathered[role][0].part.columns["t"] if gathered.get(role) else ""
        time, others = seconds[role], seconds[other]
        digits = (time >= 10_000) & (time < 240_000) & (time % 10_000 < 6000) & (time % 100 < 60)
        converted = time % 100 + (time % 10_000 - time % 100) * 0.6 + (time - time % 10_000) * 0.36
        if text and digits.all() and np.mean((converted >= others[0]) & (converted <= others[-1])) > 0.5:
            t = text if re.fullmatch(r"\w+|`[^`]+`", text) else f"({text})"
            mapped = f"{t} % 100 + ({t} % 10000 - {t} % 100)*0.6 + ({t} - {t} % 10000)*0.36"
            return f'; if the times of {role}.csv are digits hhmmss, write --map "{role}.t={mapped}"'
    return ""


def _in_same_period(
    times: Mapping[Role, Nanoseconds], gathered: Mapping[Role, Sequence[PartColumns]], say: Say
) -> dict[Role, Nanoseconds]:
    """Shift tables by whole periods of a wrapping clock, so that they overlap the IMU in time.

    Of several possible shifts, use the one with which the table ends nearest to the end of the IMU samples.
    """
    moved, imu = dict(times), times["imu"]
    clocks = {role: (parts[0].part.columns["t"], parts[0].period) for role, parts in gathered.items()}
    for role, time in times.items():
        period = max(clocks["imu"][1], clocks[role][1])
        shared = clocks[role][0] == clocks["imu"][0] or period in DECIMAL_PERIODS
        if (
            role != "imu" and shared and 0 < period < MINUTE and gathered[role][0].unordered
        ):  # several wraps between rows
            raise wraps_too_fast(period / SECOND, f"{role}: {printable(gathered[role][0].part.table)}")
        own = clocks[role][0] != clocks["imu"][0] or (not clocks[role][1] and int(np.ptp(time)) > period)
        if clocks["imu"][1] in DECIMAL_PERIODS and period < MINUTE and own:
            rate = SECOND * (len(imu) - 1) / int(np.ptp(imu))
            raise InputError(
                f"imu: the counter {clocks['imu'][0]} wraps every {period / SECOND:g} s and the {role} has another "
                "clock, so the offset between the clocks is unknown; specify another time column, or, if both clocks "
                f'begin at 0 s, compute the time from the row number: --map "imu.t=row/{rate:.4g}"'
            )
        if role == "imu" or not period or clocks[role][0] != clocks["imu"][0]:
            continue
        first, last = (int(edge) // period for edge in (imu[0] - time[-1], imu[-1] - time[0]))
        moves = np.arange(first, last + 2) * period
        inside = np.array([np.sum((time + m >= imu[0]) & (time + m <= imu[-1])) for m in moves])
        best = moves[inside == inside.max()]
        best = best[np.argsort(np.abs(time[-1] + best - imu[-1]))]
        moved[role] = time + best[0]
        if len(best) > 1 and role in ("gps", "truth", "odometer"):
            other = (best[1] - best[0]) / SECOND
            message = (
                f"the clock wraps every {period / SECOND:.6g} s, so several shifts fit the IMU's times; the import "
                "uses the shift with which the table ends nearest to the last IMU sample"
            )
            say(f"{role}: {message}. If this shift is wrong, add --{role}-offset {other:.10g}")
    return moved


def _moves(seconds: Mapping[Role, Array], zero: int) -> Iterator[tuple[float, str]]:
    """Yield each offset (s) with which the fixes overlap the IMU samples in time, and the reason for it."""
    imu, gps = seconds["imu"] + zero, seconds["gps"] + zero
    leap = float(max(imu[0], gps[0]) - gps_to_unix(np.array([max(imu[0], gps[0])]))[0])
    short, dated = min(imu[0], gps[0]), max(imu[0], gps[0]) * SECOND > MIN_DATE
    reasons = (
        (900, 0.0, "the clocks show the local times of two zones", short * SECOND > MIN_DATE),
        (86_400, 0.0, "one clock counts from midnight UTC", dated and short < 2 * 86_400),
        (WEEK, GPS_EPOCH % WEEK - leap, "one clock shows the GPS time of week", dated and short < WEEK),
        (1e12, GPS_EPOCH - leap, "one clock shows GPS time", short * SECOND > MIN_DATE),
        (2**32 * 1e-6, 0.0, "a counter of 2^32 microseconds has wrapped", not dated),
    )
    for period, begin, why, fits in reasons:
        sign = 1 if imu[0] > gps[0] else -1
        apart = sign * (float(np.median(imu)) - float(np.median(gps)))
        move = sign * (round((apart - begin) / period) * period + begin)
        inside = np.mean((gps + move >= imu[0]) & (gps + move <= imu[-1]))
        if fits and inside > 0.5 and (period != 900 or abs(move) <= 14 * 3600):
            yield move, why


def _one_clock(seconds: Mapping[Role, Array], gathered: Mapping[Role, Sequence[PartColumns]]) -> str:
    """Return a remedy if times of IMU and fixes have the same unit but were read in different units; otherwise "".

    For example, an IMU at 100 Hz with times in hundredths of a second has steps of 1, which the import reads as 1 ms.
    """
    both: tuple[Role, ...] = ("imu", "gps")
    texts = {role: gathered[role][0].part.columns["t"] for role in both if gathered.get(role)}
    read = {role: re.fullmatch(r"(\w+|`[^`]+`)(?:\*(1e-\d))?", text) for role, text in texts.items()}
    columns = {role: (match[1], float(match[2] or 1)) for role, match in read.items() if match}
    if len(columns) < 2 or columns["imu"][1] == columns["gps"][1]:
        return ""
    imu, gps = (seconds[role] / columns[role][1] for role in both)
    shares = [np.mean((one >= other[0]) & (one <= other[-1])) for one, other in ((gps, imu), (imu, gps))]
    if max(shares) < 0.5:
        return ""
    options: list[str] = []
    for k in range(1, 7):
        steps = [10.0**-k * float(np.median(np.diff(time))) for time in (imu, gps)]
        if FASTEST_IMU < steps[0] < SLOWEST_IMU and MIN_FIX_INTERVAL < steps[1] < MAX_STEP["gps"]:
            maps = " ".join(f'"{role}.t={column}*1e-{k}"' for role, (column, _) in columns.items())
            options.append(f"{maps} for {1 / steps[0]:.4g} Hz and {1 / steps[1]:.4g} Hz")
    message = "; without the factors the times of IMU and fixes overlap, so they have the same unit, "
    return (
        f"{message}but {' and '.join(texts.values())} have different factors; write --map {', or '.join(options)}"
        if options
        else ""
    )


def _report_other_clocks(
    times: Mapping[Role, Nanoseconds], gathered: Mapping[Role, Sequence[PartColumns]], say: Say
) -> None:
    back = gathered["imu"][0].set_back
    for role in times:
        steps = np.diff(times[role])
        if back and not gathered[role][0].set_back and back > STEPS * np.median(steps):
            message = "the clock does not restart when the IMU's clock restarts. If the pause before this recording was"
            say(f"{role}: {message} short, add --{role}-offset {-back / SECOND:.3f}")


def _cut_to_recording(seconds: dict[Role, Array], values: dict[Role, Values], say: Say) -> None:
    """Keep only rows of other roles within the time span of the IMU's recording, or all rows if none is within it."""
    begin, end = seconds["imu"][0], seconds["imu"][-1]
    for role, time in seconds.items():
        inside = (time >= begin) & (time <= end)
        if inside.any() and not inside.all():
            outside = int(np.count_nonzero(~inside))
            say(
                f"{role}: {rows_left_out(outside)}, since the recording of the IMU does not cover their times"
            )
            seconds[role] = time[inside]
            values[role] = {name: column[inside] for name, column in values[role].items()}


def assemble_imu(parts: Sequence[PartColumns], recipe: Recipe, say: Say, recording: int | None = None) -> Imu:
    time, values = join(parts, "imu", REQUIRED["imu"], say, recording)
    return _imu(_seconds({"imu": time}, recipe)[0]["imu"], values, recipe)


def _imu(time: Array, values: Values, recipe: Recipe) -> Imu:
    values = rotate(values, parse_mount(recipe.mount)) if recipe.mount else values
    return Imu(time, **{f.name: values[f.name] for f in fields(Imu) if f.name in values})


def _metadata(recipe: Recipe, zero: int) -> dict[str, Any]:
    """Return the keys of drive.toml; ``zero``: time origin, s."""
    metadata: dict[str, Any] = {"time_origin_s": zero} if zero else {}
    metadata[AXES_KEY] = recipe.imu_axes()
    if recipe.gps_from_truth:
        rate, noise = recipe.gps_from_truth
        noisy = f"white noise with a standard deviation of {noise:g} m per axis"
        metadata["gps"] = f"synthetic fixes from the truth, {rate:g} Hz, {noisy}, seed {SEED}"
    if recipe.gps_lever_arm_m:
        metadata["gps_lever_arm_m"] = list(recipe.gps_lever_arm_m)
    return with_rotation(metadata, parse_mount(recipe.mount)) if recipe.mount else metadata


def _seconds(times: Mapping[Role, Nanoseconds], recipe: Recipe) -> tuple[dict[Role, Array], int]:
    """Return the times in s, with the recipe's offsets, and their origin: a whole second for dates, otherwise 0."""
    moved: dict[Role, Nanoseconds] = {}
    for role in ROLES:
        offset = getattr(recipe, f"{role}_offset_s", 0.0)
        if not abs(offset) < 4e9:  # 126 years; after larger offsets, times in ns could exceed 64 bits
            raise InputError(
                f"--{role}-offset {offset:g} is out of range; specify a value between -4e9 and 4e9 s"
            )
        if role in times:
            moved[role] = times[role] + round(offset * SECOND)
    # A wrong time stamp years before the others must not become the origin: relative to it, the other times would be so
    # large that rounding removes their last digits.
    begins = {role: int(t[np.searchsorted(t, t[len(t) // 2] - MIN_DATE)]) for role, t in moved.items()}
    begin = min(t for role, t in begins.items() if role in ("imu", "gps") or "gps" not in moved)
    zero = begin // SECOND if begin >= MIN_DATE else 0
    return {role: (time - zero * SECOND) / SECOND for role, time in moved.items()}, zero


def _texts(parts: Sequence[PartColumns]) -> dict[str, str]:
    return {name: text for part in parts for name, text in part.part.columns.items()}


def placed_fixes(
    values: Values, origin: Origin | None, say: Say, texts: Mapping[str, str] = MappingProxyType({})
) -> tuple[Values, Origin | None]:
    """Return the fixes with x and y, m, and the origin; ``texts``: expressions of the columns."""
    if "vx" in values and "vy" in values:
        vx, vy = values.pop("vx"), values.pop("vy")
        values["speed"], values["course"] = np.hypot(vx, vy), np.arctan2(vy, vx)
    for single in ("vx", "vy"):
        if values.pop(single, None) is not None:
            say(f"gps: {single} is left out, since a velocity needs vx and vy")
    if "course" in values:
        values["course"] = np.asarray(wrap_angle(values["course"]))
    if "lat" in values and "lon" in values:
        if not len(values["lat"]):
            raise InputError("gps: no usable fix; --show shows the contents of the log")
        origin = origin or _first_place(values)
        values = add_local_position(values, values.get("alt", origin[2]), origin, "gps", texts)
    elif not {"x", "y"} <= set(values):
        raise InputError(WITHOUT_POSITION)
    for given, missing in (("std_x", "std_y"), ("std_y", "std_x")):
        if given in values and missing not in values:
            values[missing] = values[given]
    return values, origin


def _require_meters(time: Array, gps: Values, parts: Sequence[PartColumns]) -> None:
    """Reject x and y that imply an impossible speed, since they are not in meters."""
    apart = int(np.searchsorted(time, time[0] + 2.0)) if len(time) else 0
    if "lat" in gps or len(time) < 10 or not 0 < apart < len(time):
        return
    far = np.hypot(*(gps[n][apart:] - gps[n][:-apart] for n in ("x", "y")))
    if (speed := float(np.median(far / (time[apart:] - time[:-apart])))) > MAX_SPEED:
        texts = {n: text for n, text in _texts(parts).items() if n in ("x", "y")}
        maps = (" ".join(f'"gps.{n}=({text})*1e-{k}"' for n, text in texts.items()) for k in (3, 2))
        raise InputError(
            f"the fixes move at {speed:.4g} m/s (median), so x and y are not in m, or the times are not in s; write "
            "--map {} if x and y are in mm, or --map {} if they are in cm".format(*maps)
        )


def _first_place(values: Values) -> Origin:
    lat, lon, alt = (float(values[name][0]) if name in values else 0.0 for name in ("lat", "lon", "alt"))
    return lat, lon, alt


def _placed_truth(
    values: Values, origin: Origin | None, gps: Values, texts: Mapping[str, str]
) -> tuple[Values, Origin | None]:
    """Return the truth with x and y, m, and the origin; the default origin is the truth's first position.

    If the fixes have no altitude, the truth also gets the origin's altitude, since an altitude difference of 1000 m
    would stretch its track by 16 cm per kilometer.
    """
    if "lat" in values and "lon" in values:
        if origin is None and gps:
            raise InputError(
                "the truth is in degrees and the fixes are in meters; specify --origin lat,lon,alt"
            )
        origin = origin or _first_place(values)
        flat = "lat" in gps and "alt" not in gps
        values = add_local_position(
            values, origin[2] if flat else values.get("alt", origin[2]), origin, "truth", texts
        )
    if not {"x", "y"} <= set(values) or len(values["x"]) < 2:
        raise InputError(
            "truth: no column contains a position; map truth.x and truth.y, or truth.lat and truth.lon"
        )
    return values, origin


def _made_fixes(truth: Truth, rate: float, noise: float) -> tuple[Array, Values]:
    """Make fixes from the truth at ``rate``, Hz, with white noise of standard deviation ``noise``, m per axis."""
    given = f"--gps-from-truth {rate:g},{noise:g}"
    if not (0 < rate <= 1000 and 0 <= noise < np.inf):
        raise InputError(
            f"{given} can't be used; specify a rate of at most 1000 Hz and a standard deviation in m, for example 5,1"
        )
    if not (truth.time[-1] - truth.time[0]) * rate <= MAX_FIXES:
        raise InputError(f"{given} would make more than {MAX_FIXES} fixes; check the truth's times")
    time = np.arange(truth.time[0] + 0.5 / rate, truth.time[-1], 1 / rate)
    error = noise * np.random.default_rng(SEED).standard_normal((2, len(time)))
    x, y = (np.interp(time, truth.time, column) for column in (truth.x, truth.y))
    return time, {"x": x + error[0], "y": y + error[1]}


def _motion(time: Array, values: Values, gps: Values, say: Say) -> Values:
    """Return the truth's columns; compute a missing velocity from speed or positions, and the heading from velocity."""
    if "forward" in values and "theta" in values:
        body = values["forward"] + 1j * values.get("left", np.zeros(len(time)))
        east_north = body * np.exp(1j * values["theta"])
        values["vx"], values["vy"] = east_north.real, east_north.imag
    elif "speed" in values and "course" in values and "vx" not in values:
        speed, course = values["speed"], values["course"]
        values["vx"], values["vy"] = speed * np.cos(course), speed * np.sin(course)
    if "vx" not in values or "vy" not in values:
        say("truth: the velocity is computed from the differences of the positions")
        values["vx"], values["vy"] = np.gradient(values["x"], time), np.gradient(values["y"], time)
    if "theta" not in values:
        say("truth: the heading is the course, and is constant while the vehicle is slower than 1 m/s")
        values["theta"] = _held_course(values["vx"], values["vy"])
    else:
        course, rows = chord_course(time, values["x"], values["y"])
        if len(rows) < 5:  # the vehicle is slower than 1 m/s
            course, rows = chord_course(time, values["x"], values["y"], chord=1.0)
        values["theta"] = fitting_angle(values["theta"], course, rows, "truth: the heading", say)
    if gps:
        east, north = (float(np.median(values[n]) - np.median(gps[n])) for n in ("x", "y"))
        apart = np.hypot(east, north)
        if apart > 1000.0:
            say(
                f"truth: the median position is {apart:.0f} m from that of the fixes; if the truth has another "
                "origin, specify --origin"
            )
    return {name: values[name] for name in ("x", "y", "vx", "vy", "theta")}


def _held_course(vx: Array, vy: Array) -> Array:
    """Return the course (n,), rad.

    A row below `MIN_SPEED` has the course of the last faster row before it or, if there is none, of the first faster
    row; 0 if no row is faster.
    """
    moving = np.hypot(vx, vy) > MIN_SPEED
    if not moving.any():
        return np.zeros(len(vx))
    last = np.maximum.accumulate(np.where(moving, np.arange(len(vx)), -1))
    last[last < 0] = int(np.argmax(moving))
    return np.arctan2(vy, vx)[last]
