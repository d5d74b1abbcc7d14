"""Check positions, headings and velocities: rows without a fix, conventions of angles, and units of speeds."""

import math
import re
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import Origin, geodetic_to_enu, wrap_angle
from sigmaswarm.importing.units import factor_of, other_units, possible_units, scaled
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
UNITS = ("mm/s", "cm/s", "km/h", "ft/s", "mph", "knots")
# Largest ratio of the recorded speed to that of the positions, or of the speed of the positions to the recorded speed
MAX_SPEED_RATIO = 1.5
# Largest ratio of the 90% to the 10% quantile of the speed ratio; a wrong unit is a constant factor
MAX_RATIO_SPREAD = 2.0
# m/s, lowest speed at which positions are compared with a recorded speed; low, since robots are slow
MIN_COMPARED_SPEED = 0.2
MIN_MOVING_SHARE = 0.3  # smallest fraction of the recorded path that the compared stretches must contain
# rad, largest median difference of a recorded course from the course of the positions. A course that lags in turns, or
# that is computed from noisy positions, differs by less.
MAX_COURSE_ERROR = np.radians(40)
MIN_STRETCHES = 5  # smallest number of stretches for a contradiction
_SPEED = ("speed", "course", "vx", "vy")


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
    """Describe latitudes and longitudes with too few decimals, with the remedy; otherwise return "".

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


def first_place(values: Values) -> Origin:
    """Return the first position as an origin. Missing columns are 0."""
    lat, lon, alt = (float(values[name][0]) if name in values else 0.0 for name in ("lat", "lon", "alt"))
    return lat, lon, alt


def add_local_position(
    values: Values,
    altitude: Array | float,
    origin: tuple[float, float, float],
    role: str,
    texts: Mapping[str, str] = MappingProxyType({}),
) -> Values:
    """Add x and y, m, relative to an origin, from latitude and longitude, deg. ``texts`` are their expressions."""
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


def without_wrong_velocity(
    time: Array, values: Values, role: str, texts: Mapping[str, str], say: Say
) -> Values:
    """Return the columns (n,). Speed and course are left out if the positions x, y contradict one of them.

    ``texts`` are the expressions of the columns, which the messages quote. Rows with NaN are not compared.
    """
    recorded, compared = values, {name: c for name, c in values.items() if name in ("x", "y", *_SPEED)}
    known = np.all([np.isfinite(column) for column in compared.values()], axis=0)
    time, values = time[known], {name: column[known] for name, column in compared.items()}
    texts = {name: text for name, text in texts.items() if name in _SPEED}
    slowest = MIN_SPEED if "speed" not in values and "vx" not in values else MIN_COMPARED_SPEED
    begin, end = _stretches(time, values["x"], values["y"], slowest)
    speed, course = values.get("speed"), values.get("course")
    if speed is None and course is None and "vx" in values and "vy" in values:
        speed, course = np.hypot(values["vx"], values["vy"]), np.arctan2(values["vy"], values["vx"])
    if speed is not None and course is not None:
        course = np.where(speed < 0, course + np.pi, course)  # a vehicle in reverse
    if speed is not None and len(begin):  # the speed must show motion too, since positions at rest wander
        moves = np.concatenate([[0], np.cumsum(np.abs(speed) > MIN_COMPARED_SPEED)])
        both = moves[end + 1] - moves[begin] > 0.5 * (end + 1 - begin)
        largest = np.quantile(np.abs(speed), 0.9)  # limits the weight of single wrong speeds
        path = np.concatenate([[0], np.cumsum(np.minimum(np.abs(speed), largest))])
        enough = np.sum((path[end + 1] - path[begin])[both]) >= MIN_MOVING_SHARE * path[-1]
        begin, end = begin[both & enough], end[both & enough]
    wrong = ""
    if speed is not None and len(begin) < MIN_STRETCHES:
        usual = float(np.median(np.abs(speed))) if len(speed) else 0.0
        wrong = f"a median of {usual:.4g} m/s is not the speed of a vehicle" if usual > MAX_SPEED else ""
    elif (
        speed is not None
        and not 1 / MAX_SPEED_RATIO < (ratio := _ratio(time, values, speed, begin, end)) < MAX_SPEED_RATIO
    ):
        wrong = f"the speed is {ratio:.3g} times that computed from the positions (median){_remedy(ratio, texts, role)}"
    elif course is not None and len(begin) >= MIN_STRETCHES:
        dx, dy = (values[n][end] - values[n][begin] for n in ("x", "y"))
        apart = np.abs(wrap_angle(course[(begin + end) // 2] - np.arctan2(dy, dx)))
        if (middle := float(np.median(apart))) > MAX_COURSE_ERROR:
            wrong = f"the course differs from that computed from the positions by {np.degrees(middle):.0f} deg (median)"
    if not wrong:
        return recorded
    stated = ", ".join(f"{name}={text}" for name, text in texts.items())
    are = "is" if len(texts) == 1 else "are"
    say(f"{role}: {stated or 'speed and course'} {are} left out, since {wrong}")
    return {name: column for name, column in recorded.items() if name not in _SPEED}


def _ratio(
    time: Array, values: Values, speed: Array, begin: NDArray[np.int64], end: NDArray[np.int64]
) -> float:
    """Return the median ratio of the logged speed to that computed from the positions, or 1 if it varies too much."""
    sums = np.concatenate([[0.0], np.cumsum(np.abs(speed))])
    stated = (sums[end + 1] - sums[begin]) / (end + 1 - begin)
    moved = np.hypot(*(values[n][end] - values[n][begin] for n in ("x", "y"))) / (time[end] - time[begin])
    low, middle, high = np.quantile(stated / moved, (0.1, 0.5, 0.9))
    return float(middle) if high <= MAX_RATIO_SPREAD * low else 1.0


def _remedy(ratio: float, texts: dict[str, str], role: str) -> str:
    """Propose the unit whose factor is nearest to a ratio, if the two differ by less than 10%."""
    unit = min(UNITS, key=lambda u: abs(np.log(ratio * factor_of(u))))
    speeds = {name: text for name, text in texts.items() if name != "course"}
    if abs(np.log(ratio * factor_of(unit))) > 0.1 or not speeds:
        return ""
    plain = {n: t if re.fullmatch(r"\w+|`[^`]+`", t) else f"({t})" for n, t in speeds.items()}
    maps = " ".join(f'"{role}.{name}={scaled(text, factor_of(unit))}"' for name, text in plain.items())
    return f"; if it is in {unit}, write --map {maps}"


def _stretches(
    time: Array, x: Array, y: Array, slowest: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and the last rows of stretches in which the position moves clearly and steadily.

    A stretch is longer than 3 m and than ten times the noise between rows, and has at least five positions. No single
    step may make up most of the length, since a jump of a parked vehicle's fixes is not motion.
    """
    # repeated positions count once
    rows = np.flatnonzero(np.append(True, (np.diff(x) != 0) | (np.diff(y) != 0)))
    none = np.zeros(0, np.int64)
    if len(rows) < 4 * MIN_STRETCHES:
        return none, none
    x, y, time = x[rows], y[rows], time[rows]
    step = np.hypot(np.diff(x), np.diff(y))
    # 2.9 = 1.18 sqrt(6): median magnitude of x[i] - 2 x[i+1] + x[i+2] if x is white noise of variance 1 (Rayleigh)
    noise = float(np.median(np.hypot(np.diff(x, 2), np.diff(y, 2)))) / 2.9
    least = max(3.0, 10 * noise)
    steps = np.ceil(1.5 * least / max(float(np.quantile(step, 0.9)), 1e-3))
    apart, most = int(np.clip(steps, 4, len(rows) // MIN_STRETCHES)), len(rows) // MIN_STRETCHES

    def chord_of(apart: int) -> float:
        return float(np.quantile(np.hypot(x[apart:] - x[:-apart], y[apart:] - y[:-apart]), 0.9))

    noisy = chord_of(apart) < least  # at a high rate, most of each step is noise
    while noisy and apart < most and chord_of(apart) < 2 * least:
        apart = min(math.ceil(1.5 * apart), most)
    begin = np.arange(0, len(rows) - apart, apart)
    end = begin + apart
    chord = np.hypot(x[end] - x[begin], y[end] - y[begin])
    largest = np.maximum.reduceat(step[: end[-1]], begin)
    good = (chord > least) & (chord > slowest * (time[end] - time[begin])) & (largest < 0.6 * chord)
    return rows[begin[good]], rows[end[good]]
