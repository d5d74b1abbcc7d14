"""Write the filter as a Python script that needs only NumPy and FilterPy.

The script contains the source of those parts of sigmaswarm that FilterPy lacks, so its results equal those of
sigmaswarm except for rounding.
"""

import ast
import inspect
from collections.abc import Mapping
from dataclasses import fields
from types import ModuleType

from sigmaswarm import geodesy
from sigmaswarm.drives import (
    alignment,
    alignment_fit,
    events,
    gaps,
    gyro_bias,
    odometer,
    stale_fixes,
    standstill,
    tables,
    tilt_evidence,
    timeline,
)
from sigmaswarm.exports.features import context_of, fill
from sigmaswarm.filters import constants, models, starts
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.textbook import adaptive, car, kalman

FILE = "run_filter.py"
_ABSENT = ("imu_noise", "imu_gate", "fix_error", "fix_error_time", "fix_std")
"""Parameters that the script omits; filters that use them cannot be exported."""
MODEL = {
    models: "THETA ACCEL_BIAS GYRO_BIAS planar5 planar8 gps_position velocity lateral_arm lateral_velocity "
    "wheel_speed heading"
}
"""Names that the script contains, by module. An empty text means all names. FILTER and DRIVE have the same form."""
FILTER = {
    kalman: "Innovation Prediction GaussianFilter complex_step NotPositiveDefiniteError square_root",
    constants: "STANDSTILL_RATE_NOISE SLIP_GATE HEADING_GATE MOST_REJECTED GAP_TURN_STD GAP_ACCELERATION_STD "
    "GAP_TILT_STD gap_covariance process_noise_per_step ITERATIONS OUTLYING OUTLIERS OUTLIERS_SPAN LARGEST_RATIO "
    "SLOWER",
    adaptive: "",
    starts: "require_accuracy require_odometer",
    car: "Car",
}
DRIVE = {
    geodesy: "wrap_angle",
    tables: "Mask Indices NO_HEADING headings_of",
    stale_fixes: "",
    gaps: "MANY SHORTEST OVER MOST gaps_before _find_gaps gap_of usual_after",
    standstill: "",
    tilt_evidence: "TIME FORCE NUMBERS",
    **dict.fromkeys((gyro_bias, alignment_fit, alignment, odometer, timeline, events), ""),
}


def filterpy(parameters: FilterParameters, interval: float, *, as_recorded: bool = False) -> dict[str, str]:
    """Return the script by file name. Q refers to steps of ``interval`` s. For ``as_recorded`` see `PreparedDrive`."""
    p = parameters
    stated = {f.name: f for f in fields(p) if f.name not in _ABSENT}
    numbers = {name: getattr(p, name) for name in stated} | {"nominal_interval": interval}
    units = {name: f.metadata.get("unit") for name, f in stated.items()}
    listed = [f"    {n}={v!r},{f'  # {units[n]}' if units[n] else ''}" for n, v in numbers.items()]
    context = {
        "as_recorded": as_recorded,
        "parameters": "\n".join(listed),
        "measured": sorted(starts.measured_by(p)),
        "model_source": _sources_of(MODEL),
        "filter_source": _sources_of(FILTER),
        "drive_source": _sources_of(DRIVE),
    }
    return {FILE: fill("filterpy.py.in", context_of(p, interval) | context)}


def _sources_of(parts: Mapping[ModuleType, str]) -> str:
    return "\n\n\n".join(source_of(module, names.split() or None) for module, names in parts.items())


def source_of(module: ModuleType, names: list[str] | None = None) -> str:
    """Return the source of a module's constants, functions and classes: those in ``names``, by default all.

    Imports, and decorators and overloads of Numba, are omitted.
    """
    text = inspect.getsource(module)
    lines = text.splitlines()
    parts: list[str] = []
    kept = False
    for node in ast.parse(text).body[1:]:  # without the module's docstring
        if isinstance(node, ast.Expr):  # docstring of a constant
            if kept:
                parts[-1] += "\n" + "\n".join(lines[node.lineno - 1 : node.end_lineno])
            continue
        name = _name(node)
        decorators = [ast.unparse(d) for d in getattr(node, "decorator_list", [])]
        kept = name is not None and "overload" not in decorators and (names is None or name in names)
        if kept:
            compiled = any(d.startswith(("njit", "cached", "register_jitable")) for d in decorators)
            first = node.lineno if compiled or not decorators else node.decorator_list[0].lineno  # pyright: ignore
            parts.append("\n".join(lines[first - 1 : node.end_lineno]))
    return "\n\n\n".join(parts)


def _name(node: ast.stmt) -> str | None:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return node.name
    if not isinstance(node, ast.Assign):
        return None
    first = node.targets[0].elts[0] if isinstance(node.targets[0], ast.Tuple) else node.targets[0]
    return first.id if isinstance(first, ast.Name) and first.id != "Array" else None
