"""Write the filter as a C99 library with a program that replays a drive."""

import math
from collections.abc import Mapping
from operator import itemgetter

import numpy as np

from sigmaswarm.drives import events, odometer, standstill
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.mounting import Angles
from sigmaswarm.drives.tables import headings_of
from sigmaswarm.drives.tilt_evidence import NUMBERS
from sigmaswarm.errors import InputError
from sigmaswarm.exports import c_alignment, c_kernels, c_rules
from sigmaswarm.exports.c_names import STATES
from sigmaswarm.exports.c_text import with_constants
from sigmaswarm.exports.features import (
    exact_texts,
    features_of,
    fill,
    in_range,
    listed,
    values_of,
    with_definitions,
)
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.filters import requirements
from sigmaswarm.filters.compiled.layout import CONSTANTS
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import MODELS, SENSORS
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters, known_interval
from sigmaswarm.geodesy import rotation_of
from sigmaswarm.versions import __version__
from sigmaswarm.wording import printable

FILES = (
    *("ins_gps.h", "ins_gps.c", "ins_gps_align.h", "ins_gps_align.c", "replay.c", "README.md"),
    *("CMakeLists.txt", "library.json", "zephyr/module.yml", "zephyr/CMakeLists.txt", "zephyr/Kconfig"),
    *("ins_gps.py", "ins_gps_shared.c"),
)
MIN_INTERVAL = 1e-4  # s; at this IMU interval, the history of one second takes 3 to 15 MB


def c99(
    parameters: FilterParameters,
    interval: float,
    as_recorded: bool = False,
    mounting: Angles | None = None,
    lanes: Lanes | None = None,
    imu_axes: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Return the text of each file by name. Q refers to steps of ``interval`` s; ``as_recorded``: see `PreparedDrive`.

    ``mounting``: roll, pitch and yaw of the IMU, deg, for the C function that rotates raw samples. ``lanes``: filters
    of a bank; None: one filter. ``imu_axes``: expressions with which the import read the IMU's axes, for the README.

    Raises
    ------
    InputError
        If a parameter cannot be written as a C constant, the IMU's sampling rate is too high, or the model has no C
        text for this kind of filter.
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
    features, several = features_of(parameters), lanes.n > 1
    features |= {
        "USE_DOUBLE": not all(fits_float(p) for p in lanes.filters(parameters)),
        "USE_AS_RECORDED": as_recorded,
        "USE_LANES": several,
        "USE_MOUNTING": mounting is not None,
        "USE_IMU_AXES": bool(imu_axes),
    }
    values = values_of(parameters, interval) | _only_in_c(parameters, interval) | lanes.values(parameters)
    values |= c_kernels.kernels_of(parameters, features, values)
    if mounting is not None:
        values["MOUNTING"] = "{:g}, {:g} and {:g}".format(*mounting)
        values["ROTATION"] = ", ".join(f"{{{listed(row, 'R({})')}}}" for row in rotation_of(*mounting))
    width = max(map(len, imu_axes or ()), default=0)
    axes = (f"{printable(axis):{width}} = {printable(text, 1000)}" for axis, text in (imu_axes or {}).items())
    values["BEFORE_MOUNTING"] = ", before the rotation" if mounting is not None else ""
    values["IMU_AXES"] = "\n".join(axes)
    values |= c_rules.rules_of(features, events.bits_of(requirements.measured_by(parameters)))
    values |= c_alignment.alignment_of(biases=features["USE_BIASES"], tilted=features["USE_TILTED"])
    texts = {name: fill(f"{name}.in", features, values) for name in FILES}
    texts["ins_gps_align.c"] = with_constants(texts["ins_gps_align.c"], c_alignment.MODULES)
    numbers = {name: f"R({value})" for name, value in values.items()} | lanes.numbers(parameters)
    text = with_definitions(texts["ins_gps.c"], numbers)
    texts["ins_gps.c"] = with_constants(text, (*c_rules.MODULES, *c_kernels.MODULES))
    return texts


def replay_rows(
    drive: Drive, model: ModelName = "planar5", *, as_recorded: bool = False, heading: bool = False
) -> str:
    """Return the events of `replay_events` as text, the input of replay.c."""
    events = replay_events(drive, model, as_recorded=as_recorded, heading=heading)
    return "".join(",".join([name, *(repr(float(z)) for z in numbers)]) + "\n" for name, numbers in events)


def replay_events(
    drive: Drive, model: ModelName = "planar5", *, as_recorded: bool = False, heading: bool = False
) -> list[tuple[str, list[float]]]:
    """Return the events of a drive, sorted by time: ``start``, followed by ``imu``, ``fix`` and ``odometer``.

    Each event has the numbers of a row of the input of replay.c. ``model`` determines the axes of IMU and lever arm.
    ``heading`` includes headings of fixes. Fixes and readings after the last IMU sample are left out.

    Raises
    ------
    InputError
        If the IMU lacks an axis of the model.
    AlignmentError
        If the drive has no start for the filter.
    """
    requirements.require_axes(drive, model)
    initial, imu = initial_state(drive, as_recorded=as_recorded), drive.imu
    start = [initial.time, *drive.lever_arm, *initial.mean, *initial.covariance.ravel()]
    axes = ["ax", "ay", "gz"]
    if MODELS[model].tilts is not None:
        start = [*start, drive.antenna_height]
        axes += ["az", "gx", "gy"]
    gyro, tilt = initial.gyro, initial.tilt
    assert gyro is not None  # every alignment estimates the gyro bias
    start += [*gyro.bias, *gyro.variance, gyro.taken, *gyro.turns]  # in the order of InsGpsGyro
    if MODELS[model].tilts is not None:
        start += [*tilt.numbers] if tilt else [0.0] * NUMBERS
    # A fix precedes a sample of the same time.
    events = [(z[0], 0, "fix", z) for z in _fixes(drive.gps, heading)]
    if drive.odometer is not None:
        readings = zip(drive.odometer.time, drive.odometer.speed, strict=True)
        events += [(t, 0, "odometer", [t, speed]) for t, speed in readings]
    samples = zip(imu.time, *(getattr(imu, axis) for axis in axes), strict=True)
    events += [(t, 1, "imu", [t, *u]) for t, *u in samples]
    ordered = sorted((event for event in events if event[0] <= imu.time[-1]), key=itemgetter(0, 1))
    return [("start", start), *((name, numbers) for *_, name, numbers in ordered)]


def _fixes(gps: Gps, heading: bool) -> list[list[float]]:
    """Return rows of time (s), position (m) and, if logged, velocity (m/s) and standard deviations (m), east and north.

    With ``heading``, if fixes have headings, the rows have all these columns, and also the heading and its standard
    deviation, rad. A missing velocity or heading is NaN, and missing standard deviations of the position are 0.
    """
    heading = heading and gps.heading is not None
    columns = [gps.time, gps.x, gps.y]
    if (velocity := gps.velocity) is not None:
        columns += [*velocity]
    elif heading or gps.std is not None:
        columns += [np.full(len(gps), np.nan)] * 2
    if (std := gps.std) is not None:
        columns += [*std]
    elif heading:
        columns += [np.zeros(len(gps))] * 2
    if heading:
        theta, variance = headings_of(gps)
        columns += [np.where(np.isfinite(variance), theta, np.nan), np.sqrt(variance)]
    return np.column_stack(columns).tolist()


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
    """Return True if each constant of a filter is 0 or a normal number in float."""
    numbers = [*_constants(p, known_interval(p)).values(), *p.bias_std]
    low, high = 2.0**-126, (2 - 2.0**-23) * 2.0**127
    return all(v == 0 or low <= abs(v) <= high or math.isinf(v) for v in numbers)


def _texts_of_heading(used: bool) -> dict[str, str]:
    texts = {
        "ALSO_HEADING": ", const ins_gps_real *heading",
        "NO_HEADING": ", 0",
        "REPLAYED_HEADING": ", n < 9 || isnan(z[7]) ? NULL : heading",
        "OR_NINE": " || n == 9",
        "TAKES_HEADING": ", heading: Sequence[float] | None = None",
        "GIVES_HEADING": ", None if heading is None else self._reals(heading)",
    }
    return texts if used else dict.fromkeys(texts, "")


def _texts_of_axes(p: FilterParameters, uses_std: bool) -> dict[str, str]:
    tilted = MODELS[p.model].tilts is not None
    axes = ["ax", "ay", *(["az", "gx", "gy"] if tilted else []), "yaw_rate"]
    turning = [axis for axis in axes if axis != "az" and (tilted or axis != "ay")]
    row = ["t", "ax", "ay", "yaw_rate", "az", "gx", "gy"]  # columns of an imu row of replay.csv

    def joined(names: list[str], form: str, separator: str = ", ") -> str:
        return separator.join(form.format(name) for name in names)

    texts: dict[str, str] = {}
    for what, names in (("AXES", axes), ("TURNING_AXES", turning)):
        texts |= {what: joined(names, "ins_gps_real {}"), f"GIVEN_{what}": ", ".join(names)}
        texts[f"REPLAYED_{what}"] = ", ".join(f"(ins_gps_real)z[{row.index(name)}]" for name in names)
    return texts | {
        "AXES_OF_SAMPLE": joined(axes, "    sample.{0} = {0};", "\n"),
        "AXES_IN_GAP": joined(axes, "            sample->{0} = R(0.5) * (f->last.{0} + given.{0});", "\n"),
        "ALSO_STD": ", const ins_gps_real std[2]" if uses_std else "",
        "GIVEN_STD": ", std" if uses_std else "",
        "TAKES_STD": ", std: Sequence[float]" if uses_std else "",
        "STD_IN_PYTHON": ", their standard deviations (m)" if uses_std else "",
        "PASSES_STD": ", self._reals(std)" if uses_std else "",
    }


_STATE_NAMES = {"theta": "HEADING", "gyro_bias_z": "GYRO_BIAS"}


def _texts_of_states(p: FilterParameters) -> dict[str, str]:
    states = MODELS[p.model].states
    names = [f"INS_GPS_{_STATE_NAMES.get(state.name, state.name.upper())}" for state in states]
    listed = [f"    {name}, /* {state.unit} */" for name, state in zip(names, states, strict=True)]
    short = [f"#define {own} {name}" for own, name in zip(STATES, names, strict=False)]
    names_of_std = {None: "TILT_STD"} | {sensor: f"{sensor}_bias_std".upper() for sensor in SENSORS}
    stds = [(own, names_of_std[s.bias_of]) for own, s in zip(STATES[5:], states[5:], strict=False)]
    starts = [f"    b->covariance[{own}][{own}] = {std} * {std};" for own, std in stds]
    texts = {"STATE_ENUMERATORS": listed, "STATE_NAMES": short, "START_VARIANCES": starts}
    return {name: "\n".join(lines) for name, lines in texts.items()}


def _only_in_c(p: FilterParameters, interval: float) -> dict[str, str]:
    model = MODELS[p.model]
    stands, names, tilted = p.standstill_noise is not None, model.names, model.tilts is not None
    weighs, lasting = p.accuracy_scale is not None, p.fix_error is not None
    constants = _constants(p, interval)
    derived = {
        **{name: constants[name] for name in ("QUARTER_GAMMA", "SHORTENS", "SPREAD", "PATIENCE")},
        **{name: constants[name] for name in ("FIX_ERROR_RATE", "FIX_VAR")},
        "PER_ODOMETER_SCALE": constants["ODOMETER_SCALE"],
        "SLOTS": round(1.0 / odometer.INTERVAL),
        "BLOCKS": round(1.0 / standstill.BLOCK),
        "N_MEMORY": standstill.N_MEMORY,
        "HISTORY": max(1, math.ceil(1.0 / interval)),  # default of LiveFilter
        "FIXES": 64,  # 6.4 s at 10 Hz
    }
    return {
        **_texts_of_axes(p, weighs or lasting),
        **_texts_of_states(p),
        **_texts_of_heading(p.heading_noise is not None),
        **exact_texts(derived),
        "PROCESS_NOISE": listed(p.process_noise, "R({})"),
        "MEASUREMENT_NOISE": listed(p.measurement_noise, "R({})"),
        "NUMERIC_VERSION": ".".join(__version__.split(".")[:3]),
        "STATES": repr(names),
        "COUNTERS": ", time_jumps, too_fast and frozen" if stands else ", time_jumps and frozen",
        "CALM_NOTE": ", from which the filter estimates the noise at rest" if stands else "",
        "VELOCITY_NOTE": "" if p.velocity_noise is not None else " (this filter does not use it)",
        "STD_NOTE": "; this filter uses them" if weighs else "; 0 if none are stated",
        "STD_UNUSED": "    (void)std;\n" if lasting and not weighs else "",
        "BELIEF_NOTE": " /* and the correlated fix error, m east and north */" if lasting else "",
        "LEVER_AXES": ", left and up" if tilted else " and left",
        "LEVER_COLUMNS": ",left,up" if tilted else ",left",
        "SAMPLE": f"m/s2 forward{', left and up, rad/s about these axes' if tilted else ' and left, rad/s'}",
        "CSV_HEADER": ",".join(["t", *names, *(f"std_{name}" for name in names)]),
    }
