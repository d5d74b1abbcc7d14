"""Measure the noise of an IMU on a log, or read it from a tuned filter."""

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import has_table, read_with_warnings, table_file
from sigmaswarm.drives.tables import Array, Gps, Imu
from sigmaswarm.drives.urls import is_url
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.importing.convert import import_imu, request_of
from sigmaswarm.noise.allan import allan_deviation, model_parts
from sigmaswarm.noise.records import DEG_PER_HOUR, HOUR, MGAL, AxisNoise, Noise
from sigmaswarm.noise.spectrum import Fit, Interval, fit, spectrum_of
from sigmaswarm.noise.static import AXES, COARSE, Stretches, fault_of, find_stretches, step_of
from sigmaswarm.wording import counted

LONG = 1800.0
"""s: length of a stretch from which on a log shows more than white noise."""
LONG_TREND = 300.0
"""s: shortest stretch whose trend is tested."""
STATIC = 0.95
"""Share of a static log that is at rest."""
UNLIKELY = 0.1
"""Relative error of gravity above which the unit is doubtful."""
MANY = 30.0
"""Averages of a stretch of which the Allan deviation is sure,"""
MISFIT = 1.5
"""and its ratio to the model, or the inverse, that is reported."""
TREND = 4.0
"""Standard deviations by which a trend exceeds the fitted processes."""
TUNED = (
    "a tuned Q also holds the errors of the filter's model, such as slopes, tilt and wheel slip: expect larger values "
    "than the sensor's own"
)


def imu_noise(log: Drive | Imu | str | Path, **settings: Any) -> Noise:
    """Measure the noise of an IMU on a static log, or on the standstills of a drive.

    Parameters
    ----------
    log : Drive, Imu, or path
        A path is a drive's folder, a folder with imu.csv alone, or any log that `import_log` reads; it needs no fixes.
    **settings
        Of the import: ``recipe``, ``maps``, ``time``, ``choice``, as of `import_log`.

    Returns
    -------
    Noise
        White noise, bias instability and rate random walk of each axis with 95% intervals; ``table()`` shows them.

    Raises
    ------
    InputError
        The log can't be read, moves, is too short, or no axis shows its noise.
    """
    if isinstance(log, Drive):
        return _measured(log.name, log.imu, log.gps)
    if isinstance(log, Imu):
        return _measured("IMU", log, None)
    folder = Path(log)
    if is_url(log) or (folder.is_dir() and has_table(folder, "imu") and has_table(folder, "gps")):
        drive = read_with_warnings(log)[0]
        imu, gps, name = drive.imu, drive.gps, drive.name
    else:
        alone = folder if not has_table(folder, "imu") else table_file(folder, "imu")
        imu, notes = import_imu(request_of(alone, settings))
        gps, name = None, folder.resolve().stem
        for note in notes:
            warnings.warn(SigmaswarmWarning(f"{log}: {note}"), stacklevel=2)
    try:
        return _measured(name, imu, gps)
    except InputError as error:
        raise InputError(f"{log}: {error}") from None


def filter_noise(parameters: FilterParameters, name: str = "filter") -> Noise:
    """Return the noise that a filter's Q assumes for the IMU.

    Parameters
    ----------
    parameters : FilterParameters
        With ``nominal_interval``, as every tuning has it.
    name : str

    Raises
    ------
    InputError
        The filter does not state the interval of its Q.
    """
    p, dt = parameters, parameters.nominal_interval
    if dt is None:
        raise InputError(
            "the filter does not say which IMU interval its process noise refers to; add nominal_interval (s), for "
            "example nominal_interval = 0.01, to [filter] in its file"
        )
    model = MODELS[p.model]
    q = {state: max(v, 0.0) / dt for state, v in zip(model.names, p.process_noise, strict=True)}
    if model.measures_imu:
        gyro, accel = (dt * variance for variance in p.imu_noise)
        white, walks = {"ax": accel, "ay": accel, "gz": gyro}, dict[str, float]()
    else:
        accel = (q["vx"] + q["vy"]) / 2
        angles = {"gx": "roll", "gy": "pitch", "gz": "theta"}
        white = {"ax": accel, "ay": accel, **{a: q[state] for a, state in angles.items() if state in q}}
        walks = {f"{s.bias_of[0]}{s.name[-1]}": q[s.name] for s in model.states if s.bias_of}
    axes = [
        AxisNoise(
            a, _exact(white[a]), _exact(0.0), _exact(walks.get(a, 0.0)), math.inf, 0.0, *np.zeros((2, 0))
        )
        for a in AXES
        if a in white
    ]
    return Noise(name, 1 / dt, tuple(axes), (), (TUNED,))


def _exact(variance: float) -> Interval:
    return Interval(*(math.sqrt(variance),) * 3)


def _measured(name: str, imu: Imu, gps: Gps | None) -> Noise:
    stretches = find_stretches(imu, gps)
    parts = stretches.parts
    time = imu.time
    interval = float(np.mean([(time[p.stop - 1] - time[p.start]) / (p.stop - p.start - 1) for p in parts]))
    axes, remarks = list[AxisNoise](), list[str]()
    for axis in AXES:
        column = getattr(imu, axis)
        if column is None:
            continue
        values = [column[part] for part in parts]
        if fault := fault_of(values):
            remarks.append(f"{axis} left out, {fault}")
            continue
        axes.append(_axis_noise(axis, values, interval, remarks))
    if not axes:
        raise InputError(f"no axis shows its noise: {'; '.join(remarks)}")
    lengths = tuple((float(time[p.start]), (p.stop - p.start) * interval) for p in parts)
    remarks = [*_remarks_on(stretches, [length for _, length in lengths]), *_on_gravity(imu, parts), *remarks]
    return Noise(name, 1 / interval, tuple(axes), lengths, tuple(remarks))


def _axis_noise(axis: str, values: list[Array], interval: float, remarks: list[str]) -> AxisNoise:
    """Measure one axis on its static stretches; add what looks wrong to the remarks."""
    longest = max(values, key=len)
    duration = len(longest) * interval
    found = fit(spectrum_of(values, interval), duration)
    step = step_of(longest)
    if step > COARSE * np.std(longest):
        remarks.append(
            f"{axis} is quantized in steps of {step:.3g}, {step / np.std(longest):.1f} times its deviation: the white "
            "noise includes that of the steps"
        )
    trend = _trend(longest, interval, found)
    if trend:
        unit = "deg/h" if axis[0] == "g" else "mGal"
        scale = DEG_PER_HOUR if axis[0] == "g" else MGAL
        remarks.append(
            f"{axis} drifts by {scale * trend * HOUR:.3g} {unit} per hour, more than its random processes explain, as "
            "a sensor does that warms up: log it after half an hour of running"
        )
    tau, deviation = allan_deviation(values, interval)
    parts = model_parts(tau, found.white.value, found.instability.value, found.walk.value, found.time)
    ratio = deviation / np.sqrt(np.sum(np.square(parts), axis=0))
    sure = tau <= duration / MANY  # longer averages scatter
    worst = int(np.argmax(np.abs(np.log(ratio[sure])))) if sure.any() else 0
    if not 1 / MISFIT < ratio[worst] < MISFIT:
        remarks.append(
            f"{axis}: the Allan deviation at {tau[worst]:.2g} s is {ratio[worst]:.2g} times the model, as with "
            "vibration or a sensor's filter: the model describes the slow noise, which a navigation filter integrates"
        )
    return AxisNoise(axis, found.white, found.instability, found.walk, found.time, trend, tau, deviation)


def _trend(values: Array, interval: float, found: Fit) -> float:
    """Return the least-squares trend, unit/s, if the fitted processes do not explain it, else 0."""
    n = len(values)
    duration = n * interval
    if duration < LONG_TREND:
        return 0.0
    time = (np.arange(n) - (n - 1) / 2) * interval
    trend = float(np.dot(time, values - np.mean(values)) / np.dot(time, time))
    # The variance of a trend is the integral of the density times the squared response of the least-squares fit.
    x = np.geomspace(1e-2, 1e3, 2000)
    omega = 2 * x / duration
    rate = 0.0 if math.isinf(found.time) else 1 / found.time
    w, b, k = (one.value for one in (found.white, found.instability, found.walk))
    density = w**2 + b**2 / omega + k**2 / (omega**2 + rate**2)
    response = 24 * (np.sin(x) - x * np.cos(x)) / (omega**2 * duration**3)
    variance = float(np.trapezoid(density * response**2, omega)) / math.pi
    return trend if abs(trend) > TREND * math.sqrt(variance) else 0.0


def _remarks_on(stretches: Stretches, lengths: list[float]) -> list[str]:
    """Return what the stretches show and do not show."""
    total, longest = sum(lengths), max(lengths)
    remarks: list[str] = []
    if stretches.gaps:
        remarks.append(
            f"{counted(stretches.gaps, 'gap')} in the log: the parts between are used as stretches"
        )
    if stretches.share < STATIC:
        remarks.append(
            f"the log moves or is disturbed in {100 * (1 - stretches.share):.0f}% of its time; used: "
            f"{counted(len(lengths), 'standstill')}, {total:.0f} s in all; an engine's vibration counts as noise"
        )
    if longest < LONG:
        remarks.append(
            f"the longest stretch has {longest:.0f} s: it shows the white noise; of bias instability and rate random "
            "walk only what grows within that time, so take the upper ends of their intervals; log an hour at rest"
        )
    return remarks


def _on_gravity(imu: Imu, parts: tuple[slice, ...]) -> list[str]:
    """Return a remark where the accelerometer does not measure gravity."""
    if imu.az is None:
        return []
    force = math.hypot(*(float(np.mean(column[parts[0]])) for column in (imu.ax, imu.ay, imu.az)))
    if abs(force / GRAVITY - 1) < UNLIKELY:
        return []
    return [
        f"the accelerometer measures {force:.3g} m/s2 at rest instead of {GRAVITY:.3g}: the unit looks wrong (1 is g); "
        'correct it with --map "ax=acc_x*9.80665"'
    ]
