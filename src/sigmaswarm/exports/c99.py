"""Write the filter as a C99 library with a program that replays a drive."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sigmaswarm.drives import events, odometer, standstill
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import Angles
from sigmaswarm.drives.tilt_evidence import NUMBERS
from sigmaswarm.errors import InputError
from sigmaswarm.exports import c_alignment, c_kernels, c_rules
from sigmaswarm.exports.c_emitter import STATES
from sigmaswarm.exports.c_text import with_constants
from sigmaswarm.exports.features import context_of, fill, in_range, with_definitions
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.filters import starts
from sigmaswarm.filters.bank.run import stream
from sigmaswarm.filters.compiled.layout import CONSTANTS
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import MODELS, CarModel
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters, known_interval
from sigmaswarm.geodesy import rotation_of
from sigmaswarm.versions import __version__
from sigmaswarm.wording import printable

FILES = (
    "ins_gps.h", "ins_gps.c", "ins_gps_align.h", "ins_gps_align.c", "replay.c", "README.md", "CMakeLists.txt",
    "library.json", "zephyr/module.yml", "zephyr/CMakeLists.txt", "zephyr/Kconfig", "ins_gps.py", "ins_gps_shared.c",
)  # fmt: skip
FIX_FIELDS = {
    "velocity": ("has_velocity", "vx", "vy"),
    "heading": ("has_heading", "heading", "heading_variance"),
    "stated_std": ("variance[0]", "variance[1]"),
}
"""Fields of a fix in C, except time and position, by the feature that uses them."""
MIN_INTERVAL = 1e-4  # s; at this IMU interval, the history of one second takes 3 to 15 MB


def c99(
    parameters: FilterParameters,
    interval: float,
    as_recorded: bool = False,
    mounting: Angles | None = None,
    lanes: Lanes | None = None,
    imu_axes: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Return the text of each file by name.

    Q refers to steps of ``interval`` s. For the other arguments see `export_texts`.

    Raise `InputError` if a parameter cannot be written as a C constant, if the IMU's sampling rate is too high, or if
    the filter type of the model is not available in C.
    """
    if interval < MIN_INTERVAL:
        raise InputError(
            f"nominal_interval = {interval:g} s: the C library supports at most {1 / MIN_INTERVAL:g} Hz; correct "
            "the interval in [filter] of the filter's file"
        )
    model = MODELS[parameters.model]
    kinds = ("ekf",) if model.tilts else model.filter_types
    if parameters.kind not in kinds:
        raise InputError(
            f"{parameters.model} is not available as {parameters.kind} in C; use kind {' or '.join(kinds)}"
        )
    lanes = lanes or Lanes()
    context = _context(parameters, interval, lanes, imu_axes or {})
    context |= {
        "as_recorded": as_recorded,
        "mounting": mounting,
        "rotation": rotation_of(*mounting) if mounting else None,
    }
    texts = {name: fill(f"{name}.in", context) for name in FILES}
    texts["ins_gps_align.c"] = with_constants(texts["ins_gps_align.c"], c_alignment.MODULES)
    text = with_definitions(texts["ins_gps.c"], _numbers(parameters, interval) | lanes.numbers(parameters))
    texts["ins_gps.c"] = with_constants(text, (*c_rules.MODULES, *c_kernels.MODULES))
    return texts


def _context(
    parameters: FilterParameters, interval: float, lanes: Lanes, imu_axes: Mapping[str, str]
) -> dict[str, Any]:
    """Return the variables of the templates, except those of `c99`."""
    model = MODELS[parameters.model]
    width = max(map(len, imu_axes), default=0)
    axes = ("ax", "ay", "az", "gx", "gy", "yaw_rate") if model.tilts else ("ax", "ay", "yaw_rate")
    context = context_of(parameters, interval) | lanes.context(parameters)
    context |= {
        "fits_float": all(fits_float(p) for p in lanes.filters(parameters)),
        "imu_axes": [f"{printable(a):{width}} = {printable(text, 1000)}" for a, text in imu_axes.items()],
        "axes": axes,
        "turning_axes": [axis for axis in axes if axis != "az" and (model.tilts or axis != "ay")],
        "fix_fields": [
            field for feature, fields in FIX_FIELDS.items() if context[feature] for field in fields
        ],
        "states": _states(model),
        "numeric_version": ".".join(__version__.split(".")[:3]),
        "slots_per_second": round(1.0 / odometer.INTERVAL),
        "blocks_per_second": round(1.0 / standstill.BLOCK),
        "n_memory": standstill.N_MEMORY,
        "history": max(1, math.ceil(1.0 / interval)),  # default of LiveFilter
        "fixes": 64,  # 6.4 s at 10 Hz
    }
    context |= c_kernels.kernels_of(parameters, context)
    context |= c_rules.rules_of(context, events.bits_of(starts.measured_by(parameters)))
    return context | c_alignment.alignment_of(biases=context["biases"], tilted=context["tilted"])


def replay_rows(
    drive: Drive, model: ModelName = "planar5", *, as_recorded: bool = False, heading: bool = False
) -> str:
    """Return the events of `replay_events` as text, the input of replay.c."""
    events = replay_events(drive, model, as_recorded=as_recorded, heading=heading)
    return "".join(",".join([name, *(repr(float(z)) for z in numbers)]) + "\n" for name, numbers in events)


def replay_events(
    drive: Drive, model: ModelName = "planar5", *, as_recorded: bool = False, heading: bool = False
) -> list[tuple[str, list[float]]]:
    """Return the name and the numbers of each row in the input of replay.c: ``start``, then the data in order of time.

    The axes of the IMU and of the lever arm are those of ``model``. If ``heading`` is True, headings of fixes are
    included. Fixes and readings after the last IMU sample are left out. For errors see `start_numbers`.
    """
    rows = [("start", start_numbers(drive, model, as_recorded=as_recorded))]
    axes = ("ax", "ay", "gz", *(("az", "gx", "gy") if MODELS[model].tilts else ()))
    for name, t, *data in stream(drive, axes):
        if name == "fix":
            position, velocity, std, stated = data
            stated = stated if heading and drive.gps.heading is not None else None
            numbers = _fix_numbers(t, position, velocity, std, stated)
        else:
            numbers = [t, *(data[0] if name == "imu" else data)]
        rows.append((name, numbers))
    return rows


def start_numbers(drive: Drive, model: ModelName, *, as_recorded: bool) -> list[float]:
    """Return the numbers that follow ``start`` in the first row of replay.csv, the input of replay.c.

    Raise `InputError` if the drive lacks an IMU axis that the model needs, and `AlignmentError` if it has no initial
    state.
    """
    starts.require_axes(drive, model)
    initial = initial_state(drive, as_recorded=as_recorded)
    start = [initial.time, *drive.lever_arm, *initial.mean, *initial.covariance.ravel()]
    gyro, tilt = initial.gyro, initial.tilt
    assert gyro is not None  # every alignment estimates the gyro bias
    of_gyro = [*gyro.bias, *gyro.variance, gyro.taken, *gyro.turns]  # in the order of InsGpsGyro
    if not MODELS[model].tilts:
        return [*start, *of_gyro]
    return [*start, drive.antenna_height, *of_gyro, *(tilt.numbers if tilt else [0.0] * NUMBERS)]


def _fix_numbers(
    t: float, position: Sequence[float], velocity: list[float] | None, std: list[float] | None, heading: Any
) -> list[float]:
    """Return the numbers of a row ``fix``: time (s), position (m), velocity (m/s), standard deviations (m), heading.

    The last columns are omitted if they are not logged. ``heading`` contains the heading and its standard deviation
    (rad), or is None. A missing velocity or heading is NaN, and missing standard deviations of the position are 0.
    """
    numbers = [t, *position]
    if velocity or std or heading:
        numbers += velocity or [np.nan, np.nan]
    if std or heading:
        numbers += std or [0.0, 0.0]
    if heading:
        theta, sigma = heading
        numbers += [theta if np.isfinite(sigma) else np.nan, sigma]
    return numbers


def _constants(p: FilterParameters, interval: float) -> dict[str, float]:
    """Return the kernel's constants by row, with Q for steps of ``interval`` s; inf for an unused limit or noise."""
    with np.errstate(all="ignore"):
        values = KernelArray((p,)).constants(interval)[:, 0]
    constants = dict(zip(CONSTANTS, values.tolist(), strict=True))
    in_range(constants["FIX_ERROR_RATE"], "1 / fix_error_time")
    in_range(constants["ODOMETER_SCALE"], "1 / odometer_scale")
    spread = f"the spread of the sigma points (alpha = {p.alpha:g}, beta = {p.beta:g}, kappa = {p.kappa:g})"
    for name in ("QUARTER_GAMMA", "SHORTENS", "SPREAD"):
        constants[name] = 0.0 if p.kind == "ekf" else in_range(constants[name], spread)
    return constants


def fits_float(p: FilterParameters) -> bool:
    """Return True if each constant of a filter is 0, infinite or a normal number in float."""
    numbers = [*_constants(p, known_interval(p)).values(), *p.bias_std]
    low, high = 2.0**-126, (2 - 2.0**-23) * 2.0**127
    return all(v == 0 or low <= abs(v) <= high or math.isinf(v) for v in numbers)


def _numbers(p: FilterParameters, interval: float) -> dict[str, str]:
    """Return the C text of a filter's numbers by name; `features.NUMBERS` describes some of them."""
    constants = _constants(p, interval)
    numbers = constants | {name.upper(): value for name, value in vars(p).items() if isinstance(value, float)}
    numbers |= zip(("ACCEL_BIAS_STD", "GYRO_BIAS_STD"), p.bias_std, strict=True)
    numbers["TILT_STD"] = float(max(state.start_std for state in MODELS[p.model].states))
    numbers["PER_ODOMETER_SCALE"] = constants["ODOMETER_SCALE"]
    return {name: f"R({value!r})" for name, value in numbers.items()}


def _states(model: CarModel) -> list[dict[str, str]]:
    """Return, for each state, its names in the C header and source, its unit and its initial standard deviation."""
    names = {"theta": "HEADING", "gyro_bias_z": "GYRO_BIAS"}
    return [
        {
            "name": f"INS_GPS_{names.get(state.name, state.name.upper())}",
            "short": short,
            "unit": state.unit,
            "start_std": f"{state.bias_of}_bias_std".upper() if state.bias_of else "TILT_STD",
        }
        for state, short in zip(model.states, STATES, strict=False)
    ]
