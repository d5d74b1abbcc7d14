"""Compute truth with standard deviations: the fixes of a reference receiver, smoothed with the drive's IMU.

Errors at hidden fixes show by which factor the smoother's standard deviations are wrong; the result is corrected by
this factor. Errors of successive fixes are correlated, so averaging does not reduce them. Therefore, the variance of
one fix is added.
"""

import math
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.checks import MIN_SHARED_FIXES
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gaps import share_known
from sigmaswarm.drives.outages import hidden_fixes, random_windows
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.drives.tables import Gps, Mask, Truth
from sigmaswarm.errors import InputError, SigmaswarmError, SigmaswarmWarning
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.filters.tilted import rotation
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.fixes import ReceiverLog, read_fixes
from sigmaswarm.tuning.search import Progress
from sigmaswarm.tuning.tune import tune

MAX_STD = 0.1  # m per axis, largest standard deviation of the truth
HIDDEN_DURATIONS = (2.0, 20.0)  # s, range of the windows' lengths; in 2 s, a car's IMU drifts by a decimeter
HIDDEN_FIRST = 10.0  # s from the start of the filter to the first window, and between two windows
PLACEMENTS = 3  # number of random sets of hidden windows
# fraction of hidden fixes in an interval, per axis; half the interval's width in standard deviations
COVERAGE = 0.95, 1.96
OBJECTIVE = "innovation-t"
SLIP_STD = math.radians(0.1)  # rad, standard deviation of the slip angle, which fixes do not show


@dataclass(frozen=True)
class _Options:
    lever_arm: tuple[float, float, float] | None = None
    offset: float = 0.0
    accuracy: float = MAX_STD
    fix_std: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in (("accuracy", self.accuracy), ("fix_std", self.fix_std)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(
                    f"{name} = {value:g} is not a standard deviation in m; specify a number above 0"
                )


def reference(
    drive: Drive,
    fixes: "str | Path | Drive | Gps",
    *,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
    **options: Any,
) -> Drive:
    """Compute truth from the fixes of a reference receiver (RTK) on the same vehicle, and from the drive's IMU.

    A filter is tuned without truth on these fixes, and its estimates are smoothed. Float solutions, and fixes with a
    stated standard deviation above ``accuracy``, are omitted, since their errors are correlated. In the resulting gaps,
    the track is computed from the IMU.

    Parameters
    ----------
    drive : Drive
        The drive; its fixes are not used, and its truth is replaced.
    fixes : path, Drive or Gps
        Fixes of the reference receiver: a log in any format that can be imported (RTKLIB, NMEA, UBX, CSV ...), a
        drive's folder, or a `Gps` in the drive's local frame. From RTKLIB, NMEA and UBX only fixed solutions are used.
    executor, progress
        See `tune`.
    lever_arm : (float, float, float), optional
        Vector from the IMU to the reference receiver's antenna, m forward, left and up; by default 0.
    offset : float
        Time to add to the fixes' times (s), so that they are on the drive's clock; 0 by default.
    accuracy : float
        Largest standard deviation of the truth per axis, m; rows with a larger standard deviation are omitted. 0.1 by
        default.
    fix_std : float, optional
        Lower limit of the fixes' stated standard deviations, m per axis; smaller values are raised to it. If the fixes
        state none, it is the standard deviation of all fixes.
    seed : int
        Seed of the tuning, and of the windows of hidden fixes; 0 by default.

    Returns
    -------
    Drive
        The drive with truth and standard deviations at the IMU's times, and with gaps where the truth is not known.
        ``metadata`` describes the computation under ``reference``.

    Raises
    ------
    InputError
        If the fixes can't be read, have no common time with the drive, state no accuracy, or are too few, or if the
        standard deviation of the truth exceeds ``accuracy`` at all times.
    AlignmentError
        If the car hardly moves while the reference receiver has fixes.
    """
    chosen = _Options(**options)
    log, name = _log(fixes, drive, chosen.offset)
    good = _taken(log, name, drive, chosen)
    truth, about = _smoothed(
        replace(drive, gps=good, truth=None, frame="enu"), name, chosen, executor, progress
    )
    about = {
        "fixes": name,
        "fixes_given": len(log.gps),
        "fixes_taken": len(good),
        **about,
        "notes": [*log.notes],
    }
    return replace(drive, truth=truth, metadata={**drive.metadata, "reference": about})


def _smoothed(
    receiver: Drive,
    name: str,
    options: _Options,
    executor: Executor | None,
    progress: Callable[[Progress], None] | None,
) -> tuple[Truth, dict[str, Any]]:
    arm, accuracy = options.lever_arm, options.accuracy
    receiver = replace(receiver, metadata={"gps_lever_arm_m": list(arm)} if arm else {})
    parameters = _tuned(receiver, options.seed, executor, progress)
    ready = PreparedDrive(receiver)
    estimate = smooth(ready, parameters)
    if estimate.failure:
        raise SigmaswarmError(f"{name}: {estimate.failure}; check the log with sigmaswarm doctor")
    factor = _std_factor(ready, parameters, np.random.default_rng(options.seed))
    truth = _truth(estimate, receiver.gps, factor, accuracy)
    if truth is None:
        raise InputError(
            f"{name}: the truth has a standard deviation above {accuracy:g} m everywhere; raise --accuracy, or check "
            "the log with sigmaswarm doctor"
        )
    share = share_known(truth, float(receiver.imu.time[0]), float(receiver.imu.time[-1]))
    return truth, {
        "accuracy_m": accuracy,
        "offset_s": options.offset,
        "lever_arm_m": [float(v) for v in arm or (0.0, 0.0, 0.0)],
        "filter": parameters.model,
        "stretched": round(factor, 3),
        "share": round(share, 4),
    }


def _tuned(
    receiver: Drive, seed: int, executor: Executor | None, progress: Callable[[Progress], None] | None
) -> FilterParameters:
    """Tune the default filter, without ``standstill``, on the fixes of the reference receiver.

    With ``standstill``, tuning on fixes with errors of a centimeter would choose a very small noise for the
    standstill constraint. One wrongly detected standstill in an outage would move the track by meters, while the
    covariance stays small.
    """
    suggestion = suggest_filter([receiver])
    use = tuple(option for option in suggestion.use if option != "standstill")
    options: Any = {"model": suggestion.model, "use": use, "objective": OBJECTIVE, "seed": seed}
    with warnings.catch_warnings():  # the warnings concern a filter that is used only here
        warnings.simplefilter("ignore", SigmaswarmWarning)
        return tune(receiver, executor=executor, progress=progress, **options).parameters


def _log(fixes: "str | Path | Drive | Gps", drive: Drive, offset: float) -> tuple[ReceiverLog, str]:
    """Return the fixes in the drive's time and local frame, and their name."""
    if isinstance(fixes, str | Path):
        path = Path(fixes)
        return read_fixes(path, drive, offset), path.name
    gps, name = (fixes.gps, fixes.name) if isinstance(fixes, Drive) else (fixes, "the fixes")
    moved = replace(gps, time=gps.time + offset) if offset else gps
    return ReceiverLog(moved, np.ones(len(gps), dtype=np.bool_)), name


def _taken(log: ReceiverLog, name: str, drive: Drive, options: _Options) -> Gps:
    """Return the fixed solutions with a stated standard deviation of at most ``accuracy``, m."""
    gps, start, end = log.gps, drive.imu.time[0], drive.imu.time[-1]
    accuracy, fix_std = options.accuracy, options.fix_std
    if gps.std is None and fix_std is None:
        raise InputError(
            f"{name}: contains no standard deviations of its fixes; specify one for all fixes, in m per axis, with "
            "--fix-std"
        )
    if fix_std is not None:
        std_x, std_y = np.maximum(np.full((2, len(gps)), fix_std), 0.0 if gps.std is None else gps.std)
        gps = replace(gps, std_x=std_x, std_y=std_y)
    within = (gps.time >= start) & (gps.time <= end)
    if np.count_nonzero(within) < MIN_SHARED_FIXES:
        there = f"t = {gps.time[0]:.1f} to {gps.time[-1]:.1f} s" if len(gps) else "nothing"
        raise InputError(
            f"{name}: covers {there} on the drive's clock, but the IMU covers t = {start:.1f} to {end:.1f} s; "
            f"{np.count_nonzero(within)} common fixes are too few; convert both to one clock with --offset"
        )
    sure = within & log.sure
    known = sure & np.all(_stated(gps) <= accuracy, axis=0)
    if np.count_nonzero(known) < MIN_SHARED_FIXES:
        raise InputError(
            f"{name}: has too few accurate fixes: {np.count_nonzero(sure)} of {np.count_nonzero(within)} are fixed "
            f"solutions, and {np.count_nonzero(known)} of these have a stated standard deviation of at most "
            f"{accuracy:g} m per axis; raise --accuracy, or use another receiver"
        )
    return replace(gps, lat=None, lon=None, alt=None).select(known)


def _std_factor(ready: PreparedDrive, parameters: FilterParameters, rng: np.random.Generator) -> float:
    """Return the factor, 1 or more, on the smoother's standard deviations.

    With this factor, the 95% intervals contain 95% of the hidden fixes (see `COVERAGE`).
    """
    gps, start, end = ready.drive.gps, ready.initial.time, float(ready.drive.imu.time[-1])
    off: list[Array] = []
    for _ in range(PLACEMENTS):
        windows = random_windows(
            start, end, rng, length=HIDDEN_DURATIONS, first_after=HIDDEN_FIRST, apart=HIDDEN_FIRST
        )
        if not len(windows):
            return 1.0
        hidden = hidden_fixes(gps.time, windows)
        visible = replace(ready.drive, gps=gps.select(~hidden))
        estimate = smooth(PreparedDrive(visible, ready.initial), parameters)
        if estimate.failure or not hidden.any():
            continue
        off.append(_off(estimate, gps.select(hidden), ready.drive))
    if not off:
        return 1.0
    share, sigmas = COVERAGE
    return max(1.0, float(np.quantile(np.concatenate(off), share)) / sigmas)


def _off(estimate: Estimate, gps: Gps, drive: Drive) -> Array:
    """Return the distances of hidden fixes from the smoothed antenna path along each axis, in standard deviations."""
    gps = gps.select((gps.time > estimate.time[0]) & (gps.time <= estimate.time[-1]))
    antenna = _antenna(estimate.mean, drive)
    variance = np.diagonal(estimate.covariance, axis1=1, axis2=2)
    errors: list[Array] = []
    for i, (fixes, std) in enumerate(zip((gps.x, gps.y), _stated(gps), strict=True)):
        position = np.interp(gps.time, estimate.time, antenna[:, i])
        sigma = np.sqrt(np.interp(gps.time, estimate.time, variance[:, i]) + np.square(std))
        errors.append(np.abs(fixes - position) / sigma)
    return np.concatenate(errors)


def _stated(gps: Gps) -> Array:
    assert gps.std is not None
    return gps.std


def _antenna(mean: Array, drive: Drive) -> Array:
    """Return the positions of the antenna, (n, 2) m, for states (n, n_states)."""
    arm = np.array([*drive.lever_arm, drive.antenna_height])
    if any(len(model.states) == mean.shape[1] and model.tilts for model in MODELS.values()):
        return mean[:, :2] + (rotation(mean) @ arm)[:, :2]
    turned = np.exp(1j * mean[:, THETA]) * complex(arm[0], arm[1])
    return mean[:, :2] + np.column_stack([turned.real, turned.imag])


def _truth(estimate: Estimate, good: Gps, factor: float, accuracy: float) -> Truth | None:
    """Return truth at the times with a known position; None if there are fewer than two."""
    mean, time = estimate.mean, estimate.time
    deviation = factor * np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    std_x, std_y = (
        np.hypot(deviation[:, i], np.interp(time, good.time, stated))
        for i, stated in enumerate(_stated(good))
    )
    known: Mask = (std_x <= accuracy) & (std_y <= accuracy) & np.isfinite(mean).all(axis=1)
    if estimate.lost is not None:
        known &= ~estimate.lost
    if np.count_nonzero(known) < 2:
        return None
    x, y, vx, vy, theta = mean[:, : THETA + 1].T
    std_theta = np.hypot(deviation[:, THETA], SLIP_STD)
    whole = Truth(time, x, y, vx, vy, np.asarray(wrap_angle(theta)), std_x, std_y, std_theta)
    return whole.select(known)
