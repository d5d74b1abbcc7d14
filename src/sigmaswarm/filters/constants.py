"""The constants of the compiled kernel: what it takes of a filter's parameters, and by which formula.

Q is per nominal interval of the parameters' own; PATIENCE is a drive's, and left at 0.
"""

from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, CONSTANTS, MEAN, Q0, R
from sigmaswarm.filters.schedule import STANDSTILL_RATE_NOISE
from sigmaswarm.filters.table import Fields

Rule = tuple[tuple[str, ...], Callable[[Fields], dict[int, Any]]]
"""Some fields, and the constants that they make, by row."""


def constants_of(of: Fields) -> Array:
    """Those of one parameter set, shape (N_CONSTANTS, 1)."""
    constants = np.zeros((len(CONSTANTS), 1))
    constants[R.R_RATE - CONSTANT_ROWS.start] = STANDSTILL_RATE_NOISE
    write_constants(constants, of, of)
    return constants


def write_constants(constants: Array, of: Fields, names: Collection[str]) -> None:
    """Those that some fields make, into (N_CONSTANTS, n_sets)."""
    for needed, rows in _CONSTANTS_OF:
        if any(name in names for name in needed):
            for row, value in rows(of).items():
                constants[row - CONSTANT_ROWS.start] = value


def _scaling(of: Fields) -> dict[int, Any]:
    n = np.shape(of["process_noise"])[-1]
    alpha2, n_kappa = np.square(of["alpha"]), n + np.asarray(of["kappa"])
    gamma2, second = alpha2 * n_kappa, np.where(of["kind"] == "ekf", 0.0, 1.0)
    return {
        R.QUARTER_GAMMA: second * np.sqrt(gamma2) / 4,
        R.SHORTENS: -second * 8 / gamma2,
        R.SPREAD: alpha2 * (n_kappa - 1) + of["beta"],
        R.SECOND: second,
    }


def _adapting(of: Fields) -> dict[int, Any]:
    kind, forgetting = of["kind"], of["forgetting"]
    return {
        R.FORGETTING: np.where(kind == "adaptive-ukf", forgetting, 1.0),
        R.FADING: np.where(kind == "strong-tracking-ukf", forgetting, -1.0),
        R.FUZZY: np.where(kind == "fuzzy-ukf", forgetting, -1.0),
    }


def _entries(field: str, *rows: int) -> Rule:
    """A field of as many numbers, each of which is a constant."""
    return (field,), lambda of: dict(zip(rows, np.transpose(of[field]), strict=False))


def _number(field: str, row: int) -> Rule:
    """A field that is a constant."""
    return (field,), lambda of: {row: of[field]}


_CONSTANTS_OF: tuple[Rule, ...] = (
    (("alpha", "beta", "kappa", "kind"), _scaling),
    (("kind", "forgetting"), _adapting),
    _entries("process_noise", *range(Q0, Q0 + len(MEAN))),
    _entries("measurement_noise", R.RX, R.RY),
    _entries("fuzzy_widths", R.WIDTH_RATIO, R.WIDTH_TREND),
    _entries("fuzzy_gains", R.GAIN_R, R.GAIN_Q),
    _number("velocity_noise", R.R_VELOCITY),
    _number("lateral_noise", R.R_LATERAL),
    _number("standstill_noise", R.R_STANDSTILL),
    _number("odometer_noise", R.R_ODOMETER),
    (("odometer_scale",), lambda of: {R.ODOMETER_SCALE: 1 / np.asarray(of["odometer_scale"])}),
    _number("odometer_latency", R.ODOMETER_LATENCY),
    _number("rear_axle", R.REAR_AXLE),
    _number("latency", R.LATENCY),
    _number("gate", R.GATE),
    _number("accuracy_scale", R.ACCURACY),
    _number("robust_dof", R.DOF),
)
"""The fields that make constants, and how."""
