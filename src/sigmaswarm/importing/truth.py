"""Make the truth of a drive: compare its frame and clock with those of the fixes, and compute missing columns."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.truth import MIN_DELAY, truth_delay
from sigmaswarm.drives.drive import Truth
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import Origin, enu_to_geodetic, geodetic_to_enu
from sigmaswarm.importing.joining import Samples
from sigmaswarm.importing.positions import (
    MAX_DISTANCE,
    MIN_SPEED,
    Say,
    Values,
    add_local_position,
    chord_course,
    first_place,
    fitting_angle,
    without_wrong_velocity,
)
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.units import factor_of

SEED = 0  # seed of the noise of fixes made from the truth
MAX_FIXES = 10_000_000  # largest number of such fixes
MIN_EXPLAINED = 0.9  # smallest fraction of the fixes' variance that a rotated truth must explain
MIN_ROTATION = np.radians(5)  # rad, smallest reported rotation
MIN_STRETCH = 0.05  # smallest reported relative difference of scale
LAGS = np.arange(-20.0, 20.1, 0.5)  # s, tried delays of the truth; on a circle a delay looks like a rotation
# Smallest ratio of the residual variance of the unchanged truth, at the best delay, to that of the rotated truth
MIN_VARIANCE_RATIO = 4.0
ANGLE_TOLERANCE = 0.02  # rad, angle within which axes count as exactly exchanged or reversed
# m per unit of length
LENGTHS = {unit: factor_of(unit) for unit in ("mm", "cm", "dm", "ft", "yd", "km", "mi", "nmi")}
MIN_FIXES = 10  # smallest number of fixes at times of the truth


def made_truth(
    seconds: Mapping[Role, Array],
    truth: Samples,
    origin: Origin | None,
    gps: Values,
    recipe: Recipe,
    say: Say,
) -> tuple[Truth, Origin | None]:
    """Return the truth, and the origin of the local frame. By default, the origin is the truth's first position."""
    time, texts = seconds["truth"], truth.texts
    placed, origin = _placed(truth.values, origin, gps, texts)
    message = require_same_axes(seconds, placed, gps, texts) if gps else ""
    assumed = "lat" in gps and "lat" not in placed and recipe.origin is None
    if assumed and origin is not None and not message:
        message = assumed_origin(seconds, placed, gps, origin)
    if message:
        say(message)
    if {"speed", "course"} <= placed.keys() or {"vx", "vy"} <= placed.keys():
        placed = without_wrong_velocity(time, placed, "truth", texts, say)
    return Truth(time, **_motion(time, placed, gps, say)), origin


def _placed(
    values: Values, origin: Origin | None, gps: Values, texts: Mapping[str, str]
) -> tuple[Values, Origin | None]:
    """Return the truth with x and y, m, and the origin.

    If the fixes have no altitude, the truth also gets the origin's altitude, since an altitude difference of 1000 m
    would stretch its track by 16 cm per kilometer.
    """
    if "lat" in values and "lon" in values:
        if origin is None and gps:
            raise InputError(
                "the truth is in degrees and the fixes are in meters; specify --origin lat,lon,alt"
            )
        origin = origin or first_place(values)
        flat = "lat" in gps and "alt" not in gps
        values = add_local_position(
            values, origin[2] if flat else values.get("alt", origin[2]), origin, "truth", texts
        )
    if not {"x", "y"} <= set(values) or len(values["x"]) < 2:
        raise InputError(
            "truth: no column contains a position; map truth.x and truth.y, or truth.lat and truth.lon"
        )
    return values, origin


def require_same_axes(
    seconds: Mapping[Role, Array], truth: Values, gps: Values, texts: Mapping[str, str]
) -> str:
    """Refuse truth whose x and y are not m east and north, but exchanged, rotated, or in another unit.

    Let z be the fixes and w the truth, as complex numbers minus their means. Wrong axes or units give z = a w with a
    factor a other than 1, or z = a conj(w). If a clock offset explains the difference, return a message with the
    offset; otherwise return "".
    """
    places = [values["x"] + 1j * values["y"] for values in (gps, truth)]
    delay = truth_delay(seconds["gps"], places[0], seconds["truth"], places[1]) or 0.0
    if abs(delay) >= MIN_DELAY:
        message = (
            f"truth: its velocities occur about {abs(delay):.2f} s {'later' if delay > 0 else 'earlier'} than those of "
            f"the fixes; write --truth-offset {-delay:.2f}"
        )
        return f"{message}, or --gps-offset {delay:.2f} if the fixes have the wrong clock"
    inside, true = _true(seconds, truth)
    if len(true) < MIN_FIXES:
        return ""
    fixes = np.column_stack([gps[n] for n in ("x", "y")])
    if "lat" in gps and np.linalg.norm(fixes[inside].mean(axis=0)) > MAX_DISTANCE:
        return ""  # so far from the origin, east and north have other directions
    z, w = (_centered(xy) for xy in (fixes[inside], true))
    power, unexplained = float(np.mean(np.abs(z) ** 2)), float(np.mean(np.abs(z - w) ** 2))
    dots = np.mean(z * w.conj()), np.mean(z * w)
    mirrored = int(np.abs(dots[1]) > np.abs(dots[0]))
    factor = complex(dots[mirrored] / max(float(np.mean(np.abs(w) ** 2)), 1e-9))
    left = power - float((dots[mirrored] * np.conj(factor)).real)
    late = [_apart(fixes, seconds, truth, lag) for lag in LAGS]
    if "lat" in truth:
        return ""
    stretched = abs(np.log(max(abs(factor), 1e-9))) > MIN_STRETCH
    if left > (1 - MIN_EXPLAINED) * power or not (
        mirrored or stretched or abs(np.angle(factor)) > MIN_ROTATION
    ):
        return ""
    if min(unexplained, *late) < MIN_VARIANCE_RATIO * left:
        return ""
    unit = min(LENGTHS, key=lambda name: abs(np.log(abs(factor) / LENGTHS[name])))
    known = abs(np.log(abs(factor) / LENGTHS[unit])) < MIN_STRETCH
    size = 1.0 if not stretched else LENGTHS[unit] if known else abs(factor)
    a, side = factor / abs(factor), -1 if mirrored else 1
    if abs(a - (quarter := 1j ** np.round(np.angle(a) / (np.pi / 2)))) < ANGLE_TOLERANCE:
        a = complex(np.round(quarter))
    x, y = texts["x"], texts["y"]
    rows = (a.real, x, -side * a.imag, y), (a.imag, x, side * a.real, y)
    maps = " ".join(f'"truth.{n}={_combined(size, *row)}"' for n, row in zip("xy", rows, strict=True))
    seem = f" (their unit seems to be {unit})" if stretched and known else ""
    raise InputError(
        f"the truth's x and y, read as m east and north, do not match the track of the fixes{seem}; write --map {maps}"
    )


def _apart(fixes: Array, seconds: Mapping[Role, Array], truth: Values, lag: float) -> float:
    """Return the mean squared distance, m2, of fixes (n, 2) from the truth ``lag`` s later, both minus their means."""
    inside, true = _true(seconds, truth, lag)
    if np.count_nonzero(inside) < max(MIN_FIXES, len(fixes) // 2):
        return np.inf
    return float(np.mean(np.abs(_centered(fixes[inside]) - _centered(true)) ** 2))


def _centered(xy: Array) -> NDArray[np.complex128]:
    return (xy - xy.mean(axis=0)) @ np.array([1, 1j])


def _combined(size: float, one: float, x: str, other: float, y: str) -> str:
    """Return ``size * (one * x + other * y)`` as the text of an expression."""
    factors = ((size * one, x), (size * other, y))
    return " + ".join(text if k == 1 else f"{k:.6g}*({text})" for k, text in factors if k)


def _true(seconds: Mapping[Role, Array], truth: Values, lag: float = 0.0) -> tuple[NDArray[np.bool_], Array]:
    """Return a mask of the fixes for which the truth ``lag`` s later is known, and this truth (m, 2)."""
    time = seconds["gps"] + lag
    inside = (time >= seconds["truth"][0]) & (time <= seconds["truth"][-1])
    return inside, np.column_stack([np.interp(time[inside], seconds["truth"], truth[n]) for n in ("x", "y")])


def assumed_origin(seconds: Mapping[Role, Array], truth: Values, gps: Values, origin: Origin) -> str:
    message = "truth: the origin of x and y is assumed to be the first fix"
    inside, true = _true(seconds, truth)
    if len(true) < 3:
        return f"{message}; specify the origin with --origin lat,lon,alt"
    height = gps.get("alt", np.full(len(inside), origin[2]))[inside]

    def apart(begin: Origin) -> Array:
        return geodetic_to_enu(gps["lat"][inside], gps["lon"][inside], height, begin)[:, :2] - true

    off = apart(origin)
    (east, north), spread = np.mean(off, axis=0), np.std(off, axis=0) / np.sqrt(len(true))
    if np.hypot(east, north) > MAX_DISTANCE:
        return (
            f"{message}, but then the truth is {np.hypot(east, north) / 1e3:.0f} km from the fixes, so it probably has "
            "coordinates of a map (UTM); convert them to degrees, for example with pyproj, and map truth.lat and "
            "truth.lon"
        )
    best = origin
    for _ in range(3):  # the direction of north depends on the place
        move = np.append(np.mean(apart(best), axis=0), 0.0)[None]
        lat, lon, _ = enu_to_geodetic(move, best)[0]
        best = float(lat), float(lon), origin[2]
    state = f"specify the origin: --origin {best[0]:.8f},{best[1]:.8f},{best[2]:.3f} fits the fixes best"
    if np.all(np.abs([east, north]) < 5 * spread):
        return f"{message}; {state}"
    return f"{message}, but then the fixes lie {east:.2f} m east and {north:.2f} m north of the truth (mean); {state}"


def _motion(time: Array, values: Values, gps: Values, say: Say) -> Values:
    """Return the truth's columns.

    A missing velocity is computed from speed or positions, and the heading from velocity.
    """
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
    row. If no row is faster, the course is 0.
    """
    moving = np.hypot(vx, vy) > MIN_SPEED
    if not moving.any():
        return np.zeros(len(vx))
    last = np.maximum.accumulate(np.where(moving, np.arange(len(vx)), -1))
    last[last < 0] = int(np.argmax(moving))
    return np.arctan2(vy, vx)[last]


def fixes_of_truth(truth: Truth, rate: float, noise: float) -> tuple[Array, Values]:
    """Make fixes from the truth at ``rate``, Hz, with white noise of standard deviation ``noise``, m per axis."""
    given = f"--gps-from-truth {rate:g},{noise:g}"
    if not (0 < rate <= 1000 and 0 <= noise < np.inf):
        raise InputError(
            f"{given} is not valid; specify a rate of at most 1000 Hz and a standard deviation in m, for example 5,1"
        )
    if not (truth.time[-1] - truth.time[0]) * rate <= MAX_FIXES:
        raise InputError(f"{given} would make more than {MAX_FIXES} fixes; check the truth's times")
    time = np.arange(truth.time[0] + 0.5 / rate, truth.time[-1], 1 / rate)
    error = noise * np.random.default_rng(SEED).standard_normal((2, len(time)))
    x, y = (np.interp(time, truth.time, column) for column in (truth.x, truth.y))
    return time, {"x": x + error[0], "y": y + error[1]}
