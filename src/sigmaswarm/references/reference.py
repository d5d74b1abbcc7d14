"""`reference`: the fixes of a good receiver, smoothed with the drive's IMU, as truth that says how sure it is.

The filter is tuned on these fixes alone, and smoothed (`filters.smoothing`). How sure the smoother is of itself is not
taken on trust: fixes are hidden from it for some seconds, again and again, and its deviations are stretched until they
cover those. The receiver's own deviation is added, since its errors last: the mean of many fixes is as wrong as one.
"""

import math
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.checks import FEWEST_FIXES
from sigmaswarm.drives.drive import Array, Drive, Gps, Truth
from sigmaswarm.drives.outages import hidden_fixes, random_windows
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import suggest_filter
from sigmaswarm.errors import InputError, SigmaswarmError, SigmaswarmWarning
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.filters.tilted import rotation
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.fixes import ReceiverLog, read_fixes
from sigmaswarm.scoring.truth_noise import share_known
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.search import Progress
from sigmaswarm.tuning.tune import tune

ACCURACY = 0.1
"""m per axis: what is not known as well is left out."""
HIDDEN = (2.0, 20.0)
"""s for which fixes are hidden from the smoother: what it bridges to a decimeter with the IMUs of cars, and beyond."""
HIDDEN_FIRST = 10.0
"""s from the start before fixes are hidden, and between two windows."""
PLACEMENTS = 3
"""Of the hidden windows."""
COVERED = 0.95, 1.96
"""Share of the hidden fixes that is to lie within so many sigma, by axis."""
OBJECTIVE = "innovation-t"
SLIP = math.radians(0.1)
"""rad: added to the heading's deviation. A rear axle slips sideways by as much for seconds; fixes do not show it."""


def reference(
    drive: Drive,
    fixes: "str | Path | Drive | Gps",
    *,
    lever_arm: tuple[float, float, float] | None = None,
    offset: float = 0.0,
    accuracy: float = ACCURACY,
    fix_std: float | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Drive:
    """Make truth of the fixes of a good receiver (RTK) that drove along, and of the drive's IMU.

    A filter is tuned on these fixes, without truth, and its estimates are smoothed. Float solutions, and fixes that
    the receiver itself does not know to ``accuracy``, are left out: their errors last, so that no mean of them is
    better. The IMU bridges them.

    Parameters
    ----------
    drive : Drive
        With the cheap receiver's fixes, which are not looked at. Truth that it has gives way.
    fixes : path, Drive or Gps
        Of the good receiver: a log in any format that is imported (RTKLIB, NMEA, UBX, CSV ...), a drive's folder, or a
        `Gps` in the drive's own plane. Of RTKLIB, NMEA and UBX only fixed solutions are taken.
    lever_arm : (float, float, float), optional
        m forward, left and up from the IMU to the good receiver's antenna; none by default. The drive's own is that of
        its own antenna.
    offset : float
        s to add to the fixes' times, so that both have one clock.
    accuracy : float
        m: truth that is not known to this standard deviation on each axis is left out.
    fix_std : float, optional
        m per axis: the least standard deviation of a fix, whatever it states; that of fixes that state none.
    seed : int
        Decides the tuning, and which fixes are hidden.
    executor, progress
        As in `tune`.

    Returns
    -------
    Drive
        With truth at the IMU's times, its standard deviations, and gaps where it is not known; ``metadata`` says under
        ``reference`` what it was made of.

    Raises
    ------
    InputError
        The fixes can't be read, share no time with the drive, state no accuracy, or are too few.
    AlignmentError
        If the car never moves far enough while the good receiver has fixes.
    """
    if not 0 < accuracy < np.inf:
        raise InputError(f"accuracy = {accuracy:g}: is a standard deviation in m; give a number above 0")
    if fix_std is not None and not 0 < fix_std < np.inf:
        raise InputError(f"fix_std = {fix_std:g}: is a standard deviation in m; give a number above 0")
    log, name = _log(fixes, drive, offset)
    good = _taken(log, name, drive, accuracy, fix_std)
    receiver = replace(
        drive,
        gps=good,
        truth=None,
        frame="enu",
        metadata={"gps_lever_arm_m": list(lever_arm)} if lever_arm else {},
    )
    with warnings.catch_warnings():  # of a filter that nobody takes away
        warnings.simplefilter("ignore", SigmaswarmWarning)
        tuning = _tuned(receiver, seed, executor, progress)
    ready = PreparedDrive(receiver)
    estimate = smooth(ready, tuning.parameters)
    if estimate.failure:
        raise SigmaswarmError(f"{name}: {estimate.failure}; look at the log with sigmaswarm doctor")
    stretched = _stretch(ready, tuning.parameters, np.random.default_rng(seed))
    truth = _truth(estimate, good, stretched, accuracy)
    if truth is None:
        raise InputError(
            f"{name}: the car's place is nowhere known to {accuracy:g} m; raise --accuracy, or look at the log with "
            "sigmaswarm doctor"
        )
    share = share_known(truth, float(drive.imu.time[0]), float(drive.imu.time[-1]))
    about: dict[str, Any] = {
        "fixes": name,
        "fixes_given": len(log.gps),
        "fixes_taken": len(good),
        "accuracy_m": accuracy,
        "offset_s": offset,
        "lever_arm_m": [float(v) for v in lever_arm or (0.0, 0.0, 0.0)],
        "filter": tuning.parameters.model,
        "stretched": round(stretched, 3),
        "share": round(share, 4),
        "notes": list(log.notes),
    }
    return replace(drive, truth=truth, metadata={**drive.metadata, "reference": about})


def _tuned(
    receiver: Drive, seed: int, executor: Executor | None, progress: Callable[[Progress], None] | None
) -> Tuning[FilterParameters]:
    """The filter that suits the drive, tuned on the good receiver's fixes.

    Without ``standstill``, which fixes to a centimeter say better: tuned on them it is taken so strictly that one
    standstill that is none, in an outage, puts the track off by meters and leaves the covariance small.
    """
    found = suggest_filter([receiver])
    use = tuple(option for option in found.use if option != "standstill")
    asked: Any = {"model": found.model, "use": use, "objective": OBJECTIVE, "seed": seed}
    return tune(receiver, executor=executor, progress=progress, **asked)


def _log(fixes: "str | Path | Drive | Gps", drive: Drive, offset: float) -> tuple[ReceiverLog, str]:
    """The fixes on the drive's clock and plane, and what they are called."""
    if isinstance(fixes, str | Path):
        path = Path(fixes)
        return read_fixes(path, drive, offset), path.name
    gps, name = (fixes.gps, fixes.name) if isinstance(fixes, Drive) else (fixes, "the fixes")
    moved = replace(gps, time=gps.time + offset) if offset else gps
    return ReceiverLog(moved, np.ones(len(gps), dtype=np.bool_)), name


def _taken(log: ReceiverLog, name: str, drive: Drive, accuracy: float, fix_std: float | None) -> Gps:
    """The fixes that the receiver is sure of, and knows as well as is asked for."""
    gps, start, end = log.gps, drive.imu.time[0], drive.imu.time[-1]
    if gps.std_x is None or gps.std_y is None:
        if fix_std is None:
            raise InputError(
                f"{name}: states no standard deviation of its fixes; give one for all of them, in m per axis, with "
                "--fix-std"
            )
        gps = replace(gps, std_x=np.full(len(gps), fix_std), std_y=np.full(len(gps), fix_std))
    elif fix_std is not None:
        gps = replace(gps, std_x=np.maximum(gps.std_x, fix_std), std_y=np.maximum(gps.std_y, fix_std))
    within = (gps.time >= start) & (gps.time <= end)
    if np.count_nonzero(within) < FEWEST_FIXES:
        there = f"t = {gps.time[0]:.1f} to {gps.time[-1]:.1f} s" if len(gps) else "nothing"
        raise InputError(
            f"{name}: covers {there} on the drive's clock, the IMU t = {start:.1f} to {end:.1f} s: they share "
            f"{np.count_nonzero(within)} fixes; put both on one clock with --offset"
        )
    sure = within & log.sure
    std_x, std_y = _stated(gps)
    known = sure & (std_x <= accuracy) & (std_y <= accuracy)
    if np.count_nonzero(known) < FEWEST_FIXES:
        raise InputError(
            f"{name}: of {np.count_nonzero(within)} fixes {np.count_nonzero(sure)} are fixed solutions and "
            f"{np.count_nonzero(known)} of those stated to {accuracy:g} m per axis or better, too few; raise "
            "--accuracy, or take another receiver"
        )
    # What is not read of them would only have to be written.
    taken = replace(gps, lat=None, lon=None, alt=None)
    return taken.select(known)


def _stretch(ready: PreparedDrive, parameters: FilterParameters, rng: np.random.Generator) -> float:
    """By what the smoother's deviations have to be multiplied to cover fixes that it does not see; at least 1."""
    gps, start, end = ready.drive.gps, ready.initial.time, float(ready.drive.imu.time[-1])
    off: list[Array] = []
    for _ in range(PLACEMENTS):
        windows = random_windows(start, end, rng, length=HIDDEN, first_after=HIDDEN_FIRST, apart=HIDDEN_FIRST)
        if not len(windows):
            return 1.0
        hidden = hidden_fixes(gps.time, windows)
        seen = replace(ready.drive, gps=gps.select(~hidden))
        estimate = smooth(PreparedDrive(seen, ready.initial), parameters)
        if estimate.failure or not hidden.any():
            continue
        off.append(_off(estimate, gps.select(hidden), ready.drive))
    if not off:
        return 1.0
    share, sigmas = COVERED
    return max(1.0, float(np.quantile(np.concatenate(off), share)) / sigmas)


def _off(estimate: Estimate, gps: Gps, drive: Drive) -> Array:
    """How far hidden fixes lie from the smoothed antenna, in sigma, by axis."""
    gps = gps.select((gps.time > estimate.time[0]) & (gps.time <= estimate.time[-1]))
    antenna = _antenna(estimate.mean, drive)
    variance = np.diagonal(estimate.covariance, axis1=1, axis2=2)
    errors: list[Array] = []
    for i, (said, std) in enumerate(zip((gps.x, gps.y), _stated(gps), strict=True)):
        place = np.interp(gps.time, estimate.time, antenna[:, i])
        sigma = np.sqrt(np.interp(gps.time, estimate.time, variance[:, i]) + np.square(std))
        errors.append(np.abs(said - place) / sigma)
    return np.concatenate(errors)


def _stated(gps: Gps) -> tuple[Array, Array]:
    """Stated standard deviations of the used fixes, m east and north."""
    assert gps.std_x is not None and gps.std_y is not None
    return gps.std_x, gps.std_y


def _antenna(mean: Array, drive: Drive) -> Array:
    """Where the antenna is, (n, 2) m, of states (n, n_states)."""
    arm = np.array([*drive.lever_arm, drive.antenna_height])
    if any(len(model.states) == mean.shape[1] and model.tilts for model in MODELS.values()):
        return mean[:, :2] + (rotation(mean) @ arm)[:, :2]
    turned = np.exp(1j * mean[:, THETA]) * complex(arm[0], arm[1])
    return mean[:, :2] + np.column_stack([turned.real, turned.imag])


def _truth(estimate: Estimate, good: Gps, stretched: float, accuracy: float) -> Truth | None:
    """The rows in which the place is known well enough, or None where there are fewer than two."""
    mean, time = estimate.mean, estimate.time
    deviation = stretched * np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    std_x, std_y = (
        np.hypot(deviation[:, i], np.interp(time, good.time, stated))
        for i, stated in enumerate(_stated(good))
    )
    known: NDArray[np.bool_] = (std_x <= accuracy) & (std_y <= accuracy) & np.isfinite(mean).all(axis=1)
    if estimate.lost is not None:
        known &= ~estimate.lost
    if np.count_nonzero(known) < 2:
        return None
    x, y, vx, vy, theta = mean[:, : THETA + 1].T
    std_theta = np.hypot(deviation[:, THETA], SLIP)
    whole = Truth(time, x, y, vx, vy, np.asarray(wrap_angle(theta)), std_x, std_y, std_theta)
    return whole.select(known)
