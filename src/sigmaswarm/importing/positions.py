"""Check positions and headings: rows without a fix, longitudes beyond 180 degrees, conventions of headings."""

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import geodetic_to_enu, wrap_angle
from sigmaswarm.importing.units import other_units, possible_units
from sigmaswarm.wording import rows_left_out

Say = Callable[[str], None]
Values = dict[str, Array]

# m; the largest distance of a fix from the median position is this value plus `MAX_SPEED` times the duration
MAX_DISTANCE = 100_000.0
MAX_SPEED = 150.0  # m/s, largest speed of a vehicle
MAX_MISFIT = 0.35  # rad, largest median difference between a heading and the course in the same convention
MIN_SPEED = 1.0  # m/s, lowest speed at which the course equals the heading
# Radius of a circle that contains 68.27% of normal errors, in standard deviations per axis: sqrt(-2 ln 0.3173)
RADIUS_68 = 1.515
# A phone's x points right and y to its top edge (Android's SensorEvent), so forward is y and left is -x
FLAT_NOTE = (
    "the phone is assumed to lie flat with the screen up and the top edge forward; otherwise "
    "specify its rotation with --mount, or add --mount auto"
)


def valid_positions(time: NDArray[np.int64], values: Values, role: str, say: Say) -> NDArray[np.bool_]:
    """Mark rows (n,) with a usable position: no placeholder, possible degrees, and not far from the others."""
    if "lat" not in values or "lon" not in values:
        return np.ones(len(time), bool)
    lat, lon = values["lat"], values["lon"]
    zero = (lat == lon) & (lat == np.round(lat))  # the same whole number in both is a placeholder
    if zero.any() and not zero.all():
        placed = f" at latitude {lat[zero][0]:g}, longitude {lon[zero][0]:g}"
        say(f"{role}: {rows_left_out(int(zero.sum()), placed)}, since such positions are not fixes")
    good = ~zero if not zero.all() else np.ones(len(time), bool)
    outside = good & ((np.abs(lat) > 90) | (np.abs(lon) > 360))
    if outside.any() and outside.sum() < 0.5 * good.sum():
        say(f"{role}: {rows_left_out(int(outside.sum()))}, since the latitude or longitude is impossible")
        good &= ~outside
    if not good.any() or np.abs(lat[good]).max() > 90:
        return good
    center = np.median(lat[good]), np.median(lon[good])
    north = np.radians(lat - center[0]) * 6_371_000
    east = np.asarray(wrap_angle(np.radians(lon - center[1]))) * 6_371_000 * np.cos(np.radians(center[0]))
    away = np.hypot(north, east)
    span = float(time[good][-1] - time[good][0]) * 1e-9
    far = good & (away > MAX_DISTANCE + MAX_SPEED * span)
    if far.any() and far.sum() < 0.1 * good.sum():
        first = ", including the first" if far[np.argmax(good)] else ""
        away_km = f" up to {away[far].max() / 1e3:.0f} km from the others"
        say(f"{role}: {rows_left_out(int(far.sum()), away_km)}{first}")
        good &= ~far
    return good


def coarse_degrees(values: Values) -> str:
    """Describe latitudes and longitudes with too few decimals, with the remedy; else "".

    If the values are whole degrees, other columns presumably contain the minutes.
    """
    places = [values[name] for name in ("lat", "lon") if name in values]
    for decimals in (0, 1, 2, 3, 4):
        if len(places) == 2 and all(np.allclose(v, np.round(v, decimals), rtol=0, atol=1e-9) for v in places):
            if not decimals:
                break
            meters = f"{111_200 / 10**decimals:.0f} m"
            return (
                f"latitudes and longitudes have at most {decimals} decimals, so their resolution is {meters}; the "
                "logger must write 7 decimals, in Arduino sketches with print(lat, 7)"
            )
    return ""


def with_longitudes(values: Values, role: str, say: Say) -> Values:
    """Convert longitudes of 0 to 360 degrees to -180 to 180."""
    if "lon" not in values or not (np.abs(values["lon"]) > 180).any() or (np.abs(values["lon"]) > 360).any():
        return values
    say(f"{role}: longitudes beyond 180 degrees are read as angles from 0 to 360 degrees")
    return {**values, "lon": np.mod(values["lon"] + 180, 360) - 180}


def chord_course(time: Array, x: Array, y: Array, chord: float = 6.0) -> tuple[Array, NDArray[np.int64]]:
    """Return the course (m,), rad, between positions about ``chord`` meters apart, and the rows (m,) halfway."""
    if len(time) < 10:
        return np.zeros(0), np.zeros(0, np.int64)
    step = float(np.median(np.hypot(np.diff(x), np.diff(y))))
    apart = int(np.clip(np.ceil(chord / max(step, 1e-3)), 1, len(time) // 4))
    dx, dy, dt = x[apart:] - x[:-apart], y[apart:] - y[:-apart], time[apart:] - time[:-apart]
    moving = np.hypot(dx, dy) > np.maximum(MIN_SPEED * dt * min(chord / 6.0, 1.0), chord / 2)
    return np.arctan2(dy, dx)[moving], (np.arange(len(dx)) + apart // 2)[moving]


def fitting_angle(angle: Array, course: Array, rows: NDArray[np.int64], what: str, say: Say) -> Array:
    """Convert an angle (n,) to rad counter-clockwise from east, if the course shows another convention."""
    if len(rows) < 5:
        if "heading" not in what or np.abs(angle).max(initial=0.0) < 7.0:
            return angle
        say(
            f"{what} is read as degrees clockwise from north, but the unit can't be confirmed from the course of "
            "the fixes"
        )
        return np.asarray(wrap_angle(np.pi / 2 - np.radians(angle)))
    conventions = (
        ("", angle),
        ("radians clockwise from north", np.pi / 2 - angle),
        ("degrees counter-clockwise from east", np.radians(angle)),
        ("degrees clockwise from north", np.pi / 2 - np.radians(angle)),
        (
            "unwrapped radians",
            np.degrees(angle),
        ),  # undoes a conversion from degrees, assumed for values above 6.4
    )
    errors = [float(np.median(np.abs(wrap_angle(a[rows] - course)))) for _, a in conventions]
    best = int(np.argmin(errors))
    if errors[0] <= MAX_MISFIT or errors[best] > MAX_MISFIT:
        if errors[0] > MAX_MISFIT and "heading" in what:
            apart = np.degrees(errors[0])
            say(f"{what} differs from the course by a median of {apart:.0f} deg; check or map the column")
        return angle
    say(
        f"{what} is converted from {conventions[best][0]}, since this convention agrees with the motion of the fixes"
    )
    return np.asarray(wrap_angle(conventions[best][1]))


def add_local_position(
    values: Values,
    altitude: Array | float,
    origin: tuple[float, float, float],
    role: str,
    texts: Mapping[str, str] = MappingProxyType({}),
) -> Values:
    """Add x and y, m, relative to an origin, from latitude and longitude, deg; ``texts``: their expressions."""
    for name, most in (("lat", 90.0), ("lon", 180.0)):
        wrong = values[name][np.abs(values[name]) > most]
        if len(wrong):
            both = [
                f"({text})" if re.search(r"\W", text := texts.get(n, n)) else text for n in ("lat", "lon")
            ]
            possible = possible_units(*(float(np.median(np.abs(values[n]))) for n in ("lat", "lon")))
            remedy = f"write {other_units(role, both, possible)}"
            raise InputError(f"{role}: {name} = {wrong[0]:g} is not in degrees; {remedy}")
    enu = geodetic_to_enu(values["lat"], values["lon"], altitude, origin)
    return {**values, "x": enu[:, 0], "y": enu[:, 1]}
