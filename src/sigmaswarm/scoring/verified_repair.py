"""Verified repairs of a log: those that make forecasts worse are withheld."""

import warnings
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from sigmaswarm.doctor import repairs
from sigmaswarm.doctor.findings import Diagnosis
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.sensors import stated_std, white_noise
from sigmaswarm.errors import SigmaswarmError, SigmaswarmWarning
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_innovations
from sigmaswarm.scoring.batch import Replayer

VERIFIED = {"shift-clock", "rotate", "gyro", "accelerometer", "turn", "level", "shift-fixes"}
"""Repairs that change the motion of a filter: axes, signs, units and clocks."""
WORSE = 1.05
"""Relative increase of the forecast error that contradicts a repair."""
DENSITIES = 0.02, 0.02, 0.4, 0.4, 0.02, 0.02, 0.02, 0.001
"""Noise of planar8's states, unit/sqrt(s): such a filter follows the fixes within seconds, and the IMU in between."""
LEAST_STD = 0.5
"""m: smallest standard deviation assumed of the fixes."""


def checking_filter(drive: Drive) -> FilterParameters:
    """Return the filter whose forecasts verify repairs: planar8 with the lateral constraint, without tuning."""
    dt = drive.nominal_interval
    std = max(*(stated_std(drive) or (0.0,)), white_noise(drive.gps.x + 1j * drive.gps.y), LEAST_STD)
    return FilterParameters(
        0.1,
        2.0,
        0.0,
        tuple(density**2 * dt for density in DENSITIES),
        (std**2, std**2),
        nominal_interval=dt,
        model="planar8",
        kind="ekf",
        lateral_noise=0.3**2,
        robust_dof=4.0,
    )


def repair(drive: Drive, diagnosis: Diagnosis, *, only: Collection[str] | None = None) -> Drive:
    """Return a copy of the drive with all repairs that are possible.

    A filter runs over the log before and after. Where its forecasts of the next fix, or of fixes hidden for 3
    to 5 s, get worse by more than 5%, the responsible repair of axes or clocks is withheld.

    Parameters
    ----------
    drive : Drive
        The one that was diagnosed.
    diagnosis : Diagnosis
    only : collection of str, optional
        Codes of the findings to repair; by default all.

    Returns
    -------
    Drive
        Under the same name; ``repaired`` in its metadata lists the findings that were repaired, ``withheld`` those
        whose repair was not applied.

    Warns
    -----
    SigmaswarmWarning
        A repair was withheld.
    """
    if only is not None:
        findings = tuple(f if f.code in only else replace(f, repair=None) for f in diagnosis.findings)
        diagnosis = replace(diagnosis, findings=findings)
    kept = diagnosis
    doubtful = {f.code for f in diagnosis.findings if f.repair is not None and f.repair.action in VERIFIED}
    before = _forecasts(drive) if doubtful else None
    withheld: list[str] = []
    while doubtful and before is not None:
        after = _forecasts(repairs.repair(drive, kept))
        if after is not None and np.all(after <= WORSE * before):
            break
        # Leave out the one without which the forecasts are best.
        errors: dict[str, float] = {}
        for code in sorted(doubtful):
            found = _forecasts(repairs.repair(drive, _without(kept, code)))
            errors[code] = np.inf if found is None else float(np.prod(found))
        code = min(errors, key=lambda code: errors[code])
        kept, doubtful = _without(kept, code), doubtful - {code}
        withheld.append(code)
    mended = repairs.repair(drive, kept)
    if not withheld:
        return mended
    withheld = list(dict.fromkeys(f.code for f in diagnosis.findings if f.repair and f.code in withheld))
    what = f"{drive.name}: the repair of {', '.join(withheld)} is withheld: with it a filter forecasts"
    warnings.warn(SigmaswarmWarning(f"{what} the fixes worse; check the log by hand"), stacklevel=2)
    return replace(mended, metadata={**mended.metadata, "withheld": withheld})


def _without(diagnosis: Diagnosis, code: str) -> Diagnosis:
    """Return the diagnosis without the repair of a finding."""
    findings = tuple(replace(f, repair=None) if f.code == code else f for f in diagnosis.findings)
    return replace(diagnosis, findings=findings)


def _forecasts(drive: Drive) -> Array | None:
    """RMS errors of forecasts, m: of the next fix, and of fixes hidden for 3 to 5 s; None if the filter can't run."""
    try:
        parameters = checking_filter(drive)
        innovation = run_innovations(drive, parameters).innovation
        hidden = Replayer([drive], outages=False, forecasts=True).scores([parameters]).forecast_rmse[0, 0]
    except SigmaswarmError:
        return None
    size = np.sort(np.hypot(*innovation.T))[: max(int(0.95 * len(innovation)), 1)]
    found = np.array([np.sqrt(np.mean(size**2)), hidden])
    return found[np.isfinite(found)] if np.isfinite(found[0]) else None
