"""Estimates as files: CSV with standard deviations, or TUM for trajectory tools such as evo."""

from pathlib import Path

import numpy as np
import polars as pl

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import STATE_NAMES
from sigmaswarm.filters.run import Estimate


def _states(estimate: Estimate) -> tuple[str, ...]:
    """The names of an estimate's states."""
    return next(names for names in STATE_NAMES.values() if len(names) == estimate.mean.shape[1])


def write_estimate(estimate: Estimate, path: str | Path) -> None:
    """Write an estimate in the form that the file's ending names.

    ``.csv``: t, x, y, vx, vy, theta and std_x ... std_theta (s, m, m/s, rad); planar8's biases likewise.
    ``.tum``: one line ``t x y z qx qy qz qw`` per estimate, z = 0 and the heading as a quaternion.

    Raises
    ------
    InputError
        If the ending is another, or the folder does not exist.
    """
    path = Path(path)
    check_target(path)
    _WRITERS[path.suffix](estimate, path)


def check_target(path: Path) -> None:
    """Raise `InputError` where `write_estimate` could not write, before any work is done."""
    if path.suffix not in _WRITERS:
        raise InputError(f"{path}: can't tell the format; end the name in {' or '.join(_WRITERS)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")


def _csv(estimate: Estimate, path: Path) -> None:
    columns: dict[str, Array] = {"t": estimate.time}
    columns |= {name: estimate.mean[:, i] for i, name in enumerate(_states(estimate))}
    if estimate.covariance.size:  # dead reckoning has none
        std = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
        columns |= {f"std_{name}": std[:, i] for i, name in enumerate(_states(estimate))}
    pl.DataFrame(columns).write_csv(path)


def _tum(estimate: Estimate, path: Path) -> None:
    half = estimate.mean[:, THETA] / 2
    zero = np.zeros_like(half)
    rows = [
        estimate.time,
        estimate.mean[:, 0],
        estimate.mean[:, 1],
        zero,
        zero,
        zero,
        np.sin(half),
        np.cos(half),
    ]
    np.savetxt(path, np.column_stack(rows), fmt=["%.9f", *["%.6f"] * 3, *["%.9f"] * 4])


_WRITERS = {".csv": _csv, ".tum": _tum}
