"""Repair a drive, but reject repairs that increase the prediction errors of the fixes."""

import warnings
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor import repairs
from sigmaswarm.doctor.findings import Diagnosis
from sigmaswarm.doctor.repairs import CLOCK_ACTIONS, VERIFIED_ACTIONS
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import has_attitude, stated_std, white_noise
from sigmaswarm.errors import SigmaswarmError, SigmaswarmWarning
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline_of
from sigmaswarm.filters.run import run_innovations
from sigmaswarm.scoring.batch import BatchScorer, PassOptions

MAX_ERROR_RATIO = 1.05
"""Largest accepted ratio (after / before) of forecast errors.

If the repair is only a rotation of the axes, the limit applies to the geometric mean of four ratios. For a log of a
tilted phone, such a repair increased one error of planar8, which does not model tilt, by 10%, but reduced the other
three errors by 28 to 58%.
"""
DENSITIES = 0.02, 0.02, 0.4, 0.4, 0.02, 0.02, 0.02, 0.001
"""Noise densities of planar8's states, unit of the state per sqrt(s).

With these densities, the filter follows the fixes over seconds and the IMU over shorter times.
"""
MIN_STD = 0.5  # m, smallest assumed standard deviation of the fixes


def checking_filter(drive: Drive) -> FilterParameters:
    """Return the filter that verifies repairs: planar8 with the lateral constraint and fixed noise."""
    dt = drive.nominal_interval
    std = max(*(stated_std(drive) or (0.0,)), white_noise(drive.gps.x + 1j * drive.gps.y), MIN_STD)
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
    """Return a repaired copy of the drive, without repairs that increase prediction errors.

    A filter with fixed noise runs over the drive before and after the repairs. For clocks and rotations, the baseline
    of the default filter also runs. These filters forecast the next fix, and fixes that are hidden for 3 to 5 s. If the
    RMS of a forecast error increases by more than 5%, the responsible repair of axes, signs, units or clocks is
    rejected. A rotation that is the only such repair is rejected if the geometric mean of these errors increases by
    more than 5%.

    Parameters
    ----------
    drive : Drive
    diagnosis : Diagnosis
        The diagnosis of this drive.
    only : collection of str, optional
        Codes of the findings to repair; by default all.

    Returns
    -------
    Drive
        Drive of the same name. In the metadata, ``repaired`` lists the codes of repaired findings, and ``withheld`` the
        codes of findings whose repair was rejected.

    Warns
    -----
    SigmaswarmWarning
        If a repair was rejected.
    """
    if only is not None:
        diagnosis = _without(diagnosis, {f.code for f in diagnosis.findings}.difference(only))
    rejected = _rejected(drive, diagnosis)
    repaired = repairs.repair(drive, _without(diagnosis, rejected))
    withheld = list(dict.fromkeys(f.code for f in diagnosis.findings if f.repair and f.code in rejected))
    if not withheld:
        return repaired
    message = (
        f"{drive.name}: {', '.join(withheld)} not repaired, since with the repair a filter predicts the fixes less "
        "accurately; repair the log yourself if you know that it has this fault"
    )
    warnings.warn(SigmaswarmWarning(message), stacklevel=2)
    return replace(repaired, metadata={**repaired.metadata, "withheld": withheld})


def _rejected(drive: Drive, diagnosis: Diagnosis) -> set[str]:
    tested = {
        f.code for f in diagnosis.findings if f.repair is not None and f.repair.action in VERIFIED_ACTIONS
    }
    filters = [checking_filter(drive)] if tested else []
    if {f.repair.action for f in diagnosis.findings if f.repair} & {*CLOCK_ACTIONS, "rotate"}:
        # the baseline of the repaired drive's default filter
        model = "tilted12" if has_attitude(repairs.repair(drive, diagnosis)) else "planar8"
        filters.append(baseline_of(drive, model, ("lateral", "standstill", "robust")))
    before = _forecasts(drive, filters)
    rejected = set[str]()
    while tested and np.isfinite(before).any():
        kept = _without(diagnosis, rejected)
        ratio = (_forecasts(repairs.repair(drive, kept), filters) / before)[~np.isnan(before)]
        rotated = {f.repair.action for f in kept.findings if f.repair} & VERIFIED_ACTIONS == {"rotate"}
        if (np.exp(np.mean(np.log(ratio))) if rotated else np.max(ratio)) <= MAX_ERROR_RATIO:
            break
        # The responsible repair is the one without which the predictions are best.
        errors: dict[str, float] = {}
        for code in sorted(tested):
            forecasts = _forecasts(repairs.repair(drive, _without(kept, {code})), filters)
            errors[code] = float(np.nan_to_num(np.prod(forecasts[np.isfinite(before)]), nan=np.inf))
        worst = min(errors, key=lambda code: errors[code])
        tested, rejected = tested - {worst}, rejected | {worst}
    return rejected


def _without(diagnosis: Diagnosis, codes: Collection[str]) -> Diagnosis:
    findings = tuple(replace(f, repair=None) if f.code in codes else f for f in diagnosis.findings)
    return replace(diagnosis, findings=findings)


def _forecasts(drive: Drive, filters: list[FilterParameters]) -> Array:
    """Return the RMS of n filters' forecast errors for the next fix and for hidden fixes, m, (2 n,); NaN if unknown.

    The largest 5% of the errors for the next fix are ignored.
    """
    errors = np.full((len(filters), 2), np.nan)
    for row, parameters in zip(errors, filters, strict=True):
        try:
            size = np.sort(np.hypot(*run_innovations(drive, parameters).innovation.T))
            scorer = BatchScorer.prepare([drive], PassOptions(forecasts=True))
            row[1] = scorer.scores([parameters]).forecast_rmse[0, 0]
        except SigmaswarmError:
            continue
        row[0] = np.sqrt(np.mean(size[: max(int(0.95 * len(size)), 1)] ** 2))
    errors[~np.isfinite(errors)] = np.nan
    return errors.ravel()
