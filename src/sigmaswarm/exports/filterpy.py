"""Write the filter as a Python script that needs only NumPy and FilterPy.

The script contains sigmaswarm's source of the parts that FilterPy lacks, so both give the same results.
"""

import ast
import inspect
from types import ModuleType

from sigmaswarm import geodesy
from sigmaswarm.drives import (
    alignment,
    alignment_fit,
    gaps,
    gyro_bias,
    stale_fixes,
    standstill,
    tables,
    tilt_evidence,
)
from sigmaswarm.drives.mounting import Angles
from sigmaswarm.errors import InputError
from sigmaswarm.exports.features import features_of, fill, listed, values_of, with_definitions
from sigmaswarm.filters import models, schedule
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.textbook import adaptive, ekf, gaussian

FILE = "run_filter.py"
WEIGHING = {
    "USE_ADAPTIVE": "SageHusa",
    "USE_FUZZY": "FuzzyNoise",
    "USE_STRONG_TRACKING": "StrongTracking",
    "USE_ROBUST": "StudentT",
    "USE_STRETCH": "stretched",
}
"""Parts of `textbook.adaptive` that a script contains, by feature."""
GAPS_IN_THE_IMU = ["MANY", "SHORTEST", "OVER", "MOST", "gaps_before", "_find_gaps", "gap_of", "usual_after"]


def filterpy(
    parameters: FilterParameters, interval: float, as_recorded: bool = False, _: Angles | None = None
) -> dict[str, str]:
    """Return the script by file name. Q refers to steps of ``interval`` s; ``as_recorded``: see `PreparedDrive`.

    The mounting is ignored, since the script reads drives, whose samples are in the axes of the vehicle.
    """
    p = parameters
    if p.odometer_noise is not None:
        raise InputError(
            "the script for FilterPy does not read an odometer; export the filter as C99, or tune without odometer"
        )
    features = features_of(p)
    model = models.MODELS[p.model]
    stands = features["USE_STANDSTILL"] and model.gyro_bias is not None
    used = ["THETA", *(["GYRO_BIAS"] if stands or features["USE_LATERAL"] else [])]
    used += [*dict.fromkeys(["planar5", p.model]), "gps_position"]
    used += ["velocity"] if features["USE_VELOCITY_OR_STANDSTILL"] else []
    used += ["lateral_arm", "lateral_velocity"] if features["USE_LATERAL"] else []
    used += ["gyro_bias"] if stands else []
    weighing = [name for feature, name in WEIGHING.items() if features[feature]]
    sources = [source_of(models, used), *([source_of(ekf, ["complex_step"])] if p.kind == "ekf" else [])]
    values = values_of(p, interval) | {
        "STATES": repr(model.names),
        "AS_RECORDED": repr(as_recorded),
        "PROCESS_NOISE": listed(p.process_noise),
        "MEASUREMENT_NOISE": listed(p.measurement_noise),
        "STANDS": "stands[k]" if features["USE_STANDSTILL"] else "False",
        "FILTERPY_NAMES": "ExtendedKalmanFilter"
        if p.kind == "ekf"
        else "MerweScaledSigmaPoints, UnscentedKalmanFilter",
        "MODEL_SOURCE": "\n\n\n".join(sources),
        "ADAPTIVE_SOURCE": "\n\n\n".join(
            [source_of(gaussian, ["Innovation"]), source_of(adaptive, weighing)]
        ),
        "WRAP_SOURCE": source_of(geodesy, ["wrap_angle"]),
        "STALE_SOURCE": source_of(stale_fixes),
        "GAPS_SOURCE": source_of(gaps, GAPS_IN_THE_IMU),
        "GAP_SOURCE": source_of(schedule, ["GAP_TURN_STD", "GAP_ACCELERATION_STD", "gap_covariance"]),
        "ALIGNMENT_SOURCE": "\n\n\n".join(
            [
                source_of(tables, ["NO_HEADING", "headings_of"]),
                source_of(tilt_evidence, ["TIME", "FORCE", "NUMBERS"]),
                *map(source_of, (gyro_bias, alignment_fit, alignment)),
            ]
        ),
        "STANDSTILL_SOURCE": source_of(standstill),
    }
    return {FILE: with_definitions(fill("filterpy.py.in", features, values), values, "{} = {}  # {}")}


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
            compiled = any(d.startswith(("njit", "cached")) for d in decorators)
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
