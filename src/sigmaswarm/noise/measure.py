"""Measure the noise of an IMU from a log, or read it from the Q of a filter."""

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import has_table, read_with_warnings, table_file
from sigmaswarm.drives.tables import IMU_AXES, Gps, Imu
from sigmaswarm.drives.urls import is_url
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters, known_interval
from sigmaswarm.importing.convert import import_imu
from sigmaswarm.importing.opening import request_of
from sigmaswarm.noise.records import AxisNoise, Noise
from sigmaswarm.noise.spectrum import Interval, allan_deviation, fit, spectrum_of
from sigmaswarm.noise.static import (
    fault_of,
    find_stretches,
    on_gravity,
    on_gyro,
    on_misfit,
    on_step,
    on_stretches,
    on_trend,
    trend_of,
)

TUNED = (
    "a tuned Q also contains the errors of the filter's model, for example from slopes, tilt and wheel slip: "
    "expect values larger than the noise of the sensor"
)


def imu_noise(log: Drive | Imu | str | Path, **settings: Any) -> Noise:
    """Measure the noise of an IMU on a static log, or on the standstills of a drive.

    Parameters
    ----------
    log : Drive, Imu, or path
        A path may be a drive's folder, a folder with imu.csv alone, or any log that `import_log` reads. Fixes are not
        needed.
    **settings
        Settings of the import (see `import_log`): ``recipe``, ``maps``, ``time``, ``choice``.

    Returns
    -------
    Noise
        White noise, bias instability and rate random walk of each axis with 95% intervals.

    Raises
    ------
    InputError
        If the log can't be read, has no standstill of 10 s, or does not show the noise of any axis.
    """
    if isinstance(log, Imu):
        return _measured("IMU", log, None)
    if isinstance(log, Drive):
        return _measured(log.name, log.imu, log.gps)
    folder = Path(log)
    if is_url(log) or (has_table(folder, "imu") and has_table(folder, "gps")):
        if settings:
            raise InputError(f"{log} is a drive; omit the import settings, since they apply to logs only")
        drive = read_with_warnings(log)[0]
        imu, gps, name = drive.imu, drive.gps, drive.name
    else:
        alone = table_file(folder, "imu") if has_table(folder, "imu") else folder
        imu, notes = import_imu(request_of(alone, settings))
        gps, name = None, folder.resolve().stem
        for note in notes:
            warnings.warn(SigmaswarmWarning(f"{log}: {note}"), stacklevel=2)
    try:
        return _measured(name, imu, gps)
    except InputError as error:
        raise InputError(f"{log}: {error}") from None


def filter_noise(parameters: FilterParameters, name: str = "filter") -> Noise:
    """Return the noise of the IMU that a filter assumes, from its Q (robot-localization: from ``imu_noise``).

    Parameters
    ----------
    parameters : FilterParameters
        Parameters with ``nominal_interval``, which every tuning has.
    name : str

    Raises
    ------
    InputError
        If the filter does not state the interval of its Q.
    """
    p, dt = parameters, known_interval(parameters)
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
    none = np.zeros(0)
    axes = [
        AxisNoise(a, _exact(white[a]), _exact(0.0), _exact(walks.get(a, 0.0)), math.inf, 0.0, none, none)
        for a in IMU_AXES
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
    for axis in imu.axes:
        values = [getattr(imu, axis)[part] for part in parts]
        if fault := fault_of(values):
            remarks.append(f"{axis} left out, {fault}")
            continue
        axes.append(_axis_noise(axis, values, interval, remarks))
    if not axes:
        raise InputError(
            f"the noise can't be measured on any axis: {'; '.join(remarks)}. Check the sensor and its range, and log "
            "all its digits"
        )
    lengths = tuple((float(time[p.start]), (p.stop - p.start) * interval) for p in parts)
    general = [*on_stretches(stretches, [length for _, length in lengths]), *on_gravity(imu, parts[0])]
    remarks += on_gyro(axes)
    remarks += on_misfit(axes, max(length for _, length in lengths))
    return Noise(name, 1 / interval, tuple(axes), lengths, (*general, *remarks))


def _axis_noise(axis: str, values: list[Array], interval: float, remarks: list[str]) -> AxisNoise:
    longest = max(values, key=len)
    fitted = fit(spectrum_of(values, interval), len(longest) * interval)
    tau, deviation = allan_deviation(values, interval)
    trend = trend_of(longest, interval, fitted)
    remarks += [*on_step(axis, longest), *on_trend(axis, trend)]
    return AxisNoise(axis, *fitted, trend, tau, deviation)
