"""Compare axes and origin of truth in meters with those of the fixes."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.truth import MIN_DELAY, truth_delay
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import Origin, enu_to_geodetic, geodetic_to_enu
from sigmaswarm.importing.positions import MAX_DISTANCE, Values
from sigmaswarm.importing.source import Part, Role
from sigmaswarm.importing.units import factor_of

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


def require_same_axes(
    seconds: Mapping[Role, Array], truth: Values, gps: Values, parts: Sequence[Part]
) -> str:
    """Refuse truth whose x and y are not m east and north, but exchanged, rotated, or in another unit.

    With fixes z and truth w, as complex numbers minus their means, wrong axes or units give z = a w with a factor a
    other than 1, or z = a conj(w). If a clock offset explains the difference, return a message with the offset;
    otherwise return "".
    """
    places = [values["x"] + 1j * values["y"] for values in (gps, truth)]
    delay = truth_delay(seconds["gps"], places[0], seconds["truth"], places[1]) or 0.0
    if abs(delay) >= MIN_DELAY:
        message = (
            f"truth: the times are about {abs(delay):.2f} s {'later' if delay > 0 else 'earlier'} than those of the "
            f"fixes with the same velocity; write --truth-offset {-delay:.2f}"
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
    x, y = ({n: t for part in parts for n, t in part.columns.items()}[n] for n in ("x", "y"))
    rows = (a.real, x, -side * a.imag, y), (a.imag, x, side * a.real, y)
    maps = " ".join(f'"truth.{n}={_combined(size, *row)}"' for n, row in zip("xy", rows, strict=True))
    seem = f" (their unit seems to be {unit})" if stretched and known else ""
    raise InputError(
        f"the truth's x and y, read as m east and north, do not fit the track of the fixes{seem}; write --map {maps}"
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
