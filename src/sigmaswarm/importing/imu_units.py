"""Detect wrong units of the IMU by the magnitude of gravity and by the changes of the fixes' course."""

import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.positions import chord_course
from sigmaswarm.importing.quantities import PER_G
from sigmaswarm.importing.source import Part, Role, texts_of
from sigmaswarm.importing.table_columns import AXES, DIMENSIONS
from sigmaswarm.importing.units import in_si, parse_unit

FORCES, RATES = AXES[:3], AXES[3:]
MAX_GRAVITY_ERROR = 0.5  # m/s2, largest deviation of a median magnitude from gravity
MAX_FORCE = 3 * GRAVITY  # m/s2, largest median magnitude of a vehicle's specific force
MAX_RATE = math.radians(2000.0)  # rad/s, largest range of common gyros
_DEGREE = math.pi / 180
# Expressions of rates without a unit, with the assumed factor to rad/s; {} stands for the column
ASSUMED_UNITS = {"{}": 1.0, "radians({})": _DEGREE}
_NAMED = map(parse_unit, ("rad/s", "deg/s", "mrad/s", "mdps", "cdps", "rpm", "rev/s", "deg/h", "deg/min"))
# Scales of common 16-bit sensors, for columns of whole numbers: factors to rad/s, and expressions
COUNTS = {
    f"counts, {per:g} per deg/s": (_DEGREE / per, f"radians({{}}/{per:g})")
    for per in (131, 65.5, 32.8, 16.4, 16, 114.3, 28.6, 14.3)
}
UNITS = {
    **{unit.text: (unit.factor, in_si(unit, "{}")) for unit in _NAMED if unit is not None},
    "0.1 deg/s": (_DEGREE / 10, "radians({}/10)"),
    **COUNTS,
}
FACTOR_TOLERANCE = 0.08  # largest relative difference from the factor of a unit
MIN_FACTOR_RATIO = 1.4  # smallest ratio, or inverse ratio, that contradicts the assumed unit
TURN_INTERVALS = (1.5, 6.0, 24.0)  # s, intervals over which changes of course are compared
MAX_INTERVAL_RATIO = 1.4  # largest ratio of an actual to an intended interval
# s, tried delays of the fixes
DELAYS = (-1.0, -0.5, -0.25, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)
# Fraction of the variance of the changes of course that the rates must explain to show another unit, and to confirm the
# assumed unit
MIN_EXPLAINED, MIN_CONFIRMED = 0.9, 0.5
MIN_TURN_STD = 0.1  # rad, smallest standard deviation of the changes of course
MIN_TURNS = 20  # smallest number of changes of course
# standard deviations; larger residuals, for example of a robot that spins in place, are left out
OUTLIER_SIGMAS = 3.0
# Cutoff of the least-squares fit: smallest singular value of the integrated rates, relative to the largest
MIN_AXIS_SHARE = 0.2
MAX_VALUES = 200_000  # largest number of values of an axis that are computed together, for several delays
MIN_DURATION_VARIANCE = 1e-12  # smallest variance of the durations, relative to their mean square


def require_gravity_in_force(imu: Imu) -> None:
    """Reject an IMU with gravity in its angular rates instead of its accelerations."""
    if imu.az is None or imu.gx is None or imu.gy is None:
        return
    if np.median(np.linalg.norm((imu.ax, imu.ay, imu.az), axis=0)) > GRAVITY / 2:
        return
    quartiles = np.quantile(np.linalg.norm((imu.gx, imu.gy, imu.gz), axis=0), [0.25, 0.5, 0.75])
    for low, middle, high in (quartiles, np.degrees(quartiles)):  # the import may have assumed deg/s
        if abs(middle - GRAVITY) < MAX_GRAVITY_ERROR and high - low < 2 * MAX_GRAVITY_ERROR:
            raise InputError(
                f"gx, gy and gz contain gravity (median magnitude {middle:.3g}), and ax, ay and az do not, so the "
                "columns or files of accelerometer and gyro are exchanged; exchange their names"
            )


def impossible_rates(imu: Imu, parts: Sequence[Part]) -> dict[str, str]:
    """Return the expressions of the angular rates if these exceed the range of common gyros; otherwise {}."""
    texts = {n: text for n, text in texts_of(parts).items() if n in RATES}
    return texts if _largest_rate(imu) > MAX_RATE else {}


def _largest_rate(imu: Imu) -> float:
    return max(float(np.quantile(np.abs(v), 0.99)) for n in RATES if (v := getattr(imu, n)) is not None)


def wrong_scale(imu: Imu, parts: Sequence[Part], rates: Mapping[str, str]) -> list[str]:
    """Describe accelerations that are too large for a vehicle, and ``rates`` (`impossible_rates`), with the remedy."""
    force, faults = [v for v in (imu.ax, imu.ay, imu.az) if v is not None], list[str]()

    def add(texts: Mapping[str, str], what: str, form: str) -> None:
        units = {text: read_name(text.strip("`")).unit for text in texts.values()}
        dimension = DIMENSIONS[next(iter(texts))]
        stated = {
            name: in_si(unit, text) if (unit := units[text]) and unit.dimension == dimension else text
            for name, text in texts.items()
        }
        # if the stated unit is already that of SI, it is wrong
        scaled = {
            name: form.format(text) if stated[name] == text else stated[name] for name, text in texts.items()
        }
        maps = " ".join(f'"imu.{name}={text}"' for name, text in scaled.items())
        scale = f"so their scale is wrong; specify it, for example --map {maps}"
        faults.append(f"{', '.join(texts.values())} {what}, {scale}")

    if (size := float(np.median(np.linalg.norm(force, axis=0)))) > MAX_FORCE:
        known = (*PER_G, GRAVITY**2)  # the latter for m/s2 that were read as g
        per = min(known, key=lambda k: abs(size / k - 1)) if len(force) == len(FORCES) else PER_G[0]
        texts = {n: text for n, text in texts_of(parts).items() if n in FORCES}
        add(texts, f"have a median magnitude of {size:.4g} m/s2", f"({{}})*9.80665/{per:g}")
    if rates:
        degrees = _largest_rate(imu) < math.degrees(MAX_RATE)
        add(rates, f"exceed {MAX_RATE:.3g} rad/s", "radians({})" if degrees else "radians(({})/131)")
    return faults


class RateUnit(NamedTuple):
    """The unit of rates: a fault with its remedy, a note, and the expression of each column in the most likely unit."""

    fault: str = ""
    note: str = ""
    expressions: Mapping[str, str] = MappingProxyType({})


def unit_of_rates(
    drive: Drive, roles: Mapping[Role, Sequence[Part]], unitless: Mapping[str, str]
) -> RateUnit:
    """Compare rates without a stated unit with the course of the fixes. Find the unit if the assumed unit is wrong.

    ``unitless`` contains, by column of the drive, the columns without a unit, as they are written in expressions. If
    the changes of course do not confirm the unit, a note states that rad/s is assumed.
    """
    rates = unitless.keys() & {"gx", "gy", "gz"}
    times = {role: parts[0].columns.get("t", "") for role, parts in roles.items() if parts}
    used = {n: text for part in roles["imu"] for n, text in part.columns.items() if n in rates}
    forms = {text.replace(unitless[n], "{}") for n, text in used.items()}
    if len(forms) != 1 or not forms <= ASSUMED_UNITS.keys():
        return RateUnit()
    assumed = ASSUMED_UNITS[forms.pop()]
    columns = ", ".join(unitless[n] for n in used)
    raw = [getattr(drive.imu, n) / assumed for n in used]
    share, ratio = turn_ratio(drive)
    if share < MIN_EXPLAINED:
        if share > MIN_CONFIRMED and 1 / MIN_FACTOR_RATIO < ratio < MIN_FACTOR_RATIO:
            return RateUnit()
        message = f"the unit of {columns} is assumed to be rad/s, but no turn of the path confirms it; for deg/s write "
        confirmable = assumed == 1 and np.any(raw)
        return RateUnit(note=message + _maps(used, unitless, "radians({})") if confirmable else "")
    whole = all(np.allclose(values, np.round(values), rtol=0, atol=1e-6) for values in raw)
    known = UNITS if whole else UNITS.keys() - COUNTS
    apart = {name: abs(math.log(ratio * assumed / UNITS[name][0])) for name in known}
    likely = sorted((name for name in apart if apart[name] < FACTOR_TOLERANCE), key=lambda name: apart[name])
    if 1 / MIN_FACTOR_RATIO < ratio < MIN_FACTOR_RATIO:
        return RateUnit()
    if not likely:
        return RateUnit(_wrong_clock(ratio, columns, times))
    maps = " or ".join(_maps(used, unitless, UNITS[name][1]) for name in likely)
    fault = f"the turns of the path show that the unit of {columns} is {' or '.join(likely)}; write {maps}"
    return RateUnit(fault, expressions={n: UNITS[likely[0]][1].format(unitless[n]) for n in used})


def _maps(names: Iterable[str], unitless: Mapping[str, str], form: str) -> str:
    return "--map " + " ".join(f'"imu.{n}={form.format(unitless[n])}"' for n in names)


def _wrong_clock(ratio: float, columns: str, times: Mapping[Any, str]) -> str:
    """Describe times whose unit is wrong by a power of ten. Return "" for other ratios, or times with a date."""
    power = round(math.log10(ratio))
    plain = all(times.values()) and "(" not in "".join(times.values())
    if not plain or abs(math.log(ratio / 10.0**power)) > FACTOR_TOLERANCE:
        return ""
    maps = " ".join(f'"{role}.t={text}*1e{power}"' for role, text in times.items())
    message = f"the changes of the course of the fixes are {ratio:.3g} times the integral of {columns}"
    return f"{message}, so the unit of the times is likely {10.0**power:g} times the assumed unit; write --map {maps}"


def turn_ratio(drive: Drive) -> tuple[float, float]:
    """Return the fraction of the variance of course changes that the gyro explains, and the ratio of both."""
    time, x, y, imu = drive.gps.time, drive.gps.x, drive.gps.y, drive.imu
    axes = np.array([v for v in (imu.gx, imu.gy, imu.gz) if v is not None])
    steps = 0.5 * (axes[:, 1:] + axes[:, :-1]) * np.diff(imu.time)
    angles = np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))
    noise = float(np.median(np.hypot(np.diff(x, 2), np.diff(y, 2)))) / 2.9 if len(time) > 2 else 0.0
    course, rows = chord_course(time, x, y, chord=float(np.clip(20 * noise, 0.5, 20.0)))
    at, best = time[rows], (0.0, 0.0)
    block = max(MAX_VALUES // max(len(at), 1), 1)
    for k in range(0, len(DELAYS), block):
        delays = DELAYS[k : k + block]
        delayed = np.array([[np.interp(at - delay, imu.time, angle) for angle in angles] for delay in delays])
        for apart in TURN_INTERVALS:
            later = np.searchsorted(at, at + apart)
            first = np.flatnonzero(later < len(at))
            first = first[at[later[first]] - at[first] < MAX_INTERVAL_RATIO * apart]
            later = later[first]
            turns, lasted = np.asarray(wrap_angle(course[later] - course[first])), at[later] - at[first]
            if len(turns) >= MIN_TURNS:
                best = max(best, _fitted(delayed[:, :, later] - delayed[:, :, first], turns, lasted))
    return best


def _fitted(measured: Array, turns: Array, lasted: Array) -> tuple[float, float]:
    """Regress the turns of the course (n,) on the measured angles (delays, axes, n), rad, for each delay.

    Return the largest explained fraction of the variance, and the norm of its coefficients; both are 0 if the turns are
    few or small. ``lasted`` (n,) contains durations, s. The axes have different biases, so angles proportional to the
    duration are removed. Otherwise the fit would cancel the biases by a combination of the axes with large factors.
    """
    both = np.concatenate([measured, np.broadcast_to(turns, (len(measured), 1, len(turns)))], axis=1)
    used, valid = np.ones((len(both), len(turns)), np.bool_), np.ones(len(both), np.bool_)
    share = ratio = np.zeros(len(both))
    for _ in range(4):
        count = np.maximum(np.sum(used, axis=1), 1)
        mean = np.sum(both, axis=2, where=used[:, None]) / count[:, None]
        both = np.where(used[:, None], both - mean[:, :, None], 0.0)
        spread = np.sqrt(np.sum(both[:, -1] ** 2, axis=1) / count)
        valid &= (count >= MIN_TURNS) & (spread >= MIN_TURN_STD)
        longer = np.where(used, lasted - (used @ lasted / count)[:, None], 0.0)
        power = np.sum(longer**2, axis=1)
        known = power > MIN_DURATION_VARIANCE * (used @ lasted**2)
        longer /= np.sqrt(np.where(known, power, np.inf))[:, None]
        both -= (both @ longer[:, :, None]) * longer[:, None]
        angles, left = both[:, :-1], both[:, -1]
        variance = np.maximum(np.sum(left**2, axis=1), 1e-300)
        # Normal equations are accurate enough here, and quicker than `numpy.linalg.lstsq` for each delay
        values, vectors = np.linalg.eigh(angles @ angles.transpose(0, 2, 1))
        known = values > MIN_AXIS_SHARE**2 * values[:, -1:]
        along = (vectors.transpose(0, 2, 1) @ (angles @ left[:, :, None]))[:, :, 0]
        factors = vectors @ np.divide(along, values, where=known, out=np.zeros_like(along))[:, :, None]
        left = left - (factors.transpose(0, 2, 1) @ angles)[:, 0]
        share, ratio = 1.0 - np.sum(left**2, axis=1) / variance, np.sqrt(np.sum(factors**2, axis=(1, 2)))
        size = np.abs(left)
        ordered = np.sort(np.where(used, size, np.inf), axis=1)
        middle = np.stack([(count - 1) // 2, count // 2], axis=1)
        median = np.mean(np.take_along_axis(ordered, middle, axis=1), axis=1)
        used &= size <= (OUTLIER_SIGMAS / 0.6745 * median)[:, None]
    return max(zip((share * valid).tolist(), (ratio * valid).tolist(), strict=True))
