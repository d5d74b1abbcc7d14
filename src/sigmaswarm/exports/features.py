"""Fill the Jinja templates of exported files."""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from sigmaswarm.errors import InputError
from sigmaswarm.filters import starts
from sigmaswarm.filters.models import MEASURED, MODELS, NOISE_OF, SENSORS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.versions import __version__


def features_of(p: FilterParameters) -> dict[str, bool]:
    """Return the features on which templates depend, by name. A feature is True if the filter has it."""
    measured = starts.measured_by(p)
    lateral, stands, wheels = (name in measured for name in ("lateral", "standstill", "odometer"))
    gate, robust = p.gate is not None, p.robust_dof is not None
    adaptive, tracking, rules = (p.kind == f"{kind}-ukf" for kind in ("adaptive", "strong-tracking", "fuzzy"))
    return {
        "unscented": p.kind != "ekf",
        "tilted": MODELS[p.model].tilts,
        "planar5": p.model == "planar5",
        "biases": bool(MODELS[p.model].sensors),
        "adaptive": adaptive,
        "strong_tracking": tracking,
        "fuzzy": rules,
        "latency": p.latency != 0.0,
        "gate": gate,
        "nis": gate or rules,
        "accuracy": p.accuracy_scale is not None,
        "fix_error": p.fix_error is not None,
        "stated_std": p.accuracy_scale is not None or p.fix_error is not None,
        "since_fix": adaptive or robust or p.fix_error is not None,
        "robust": robust,
        **{name: name in measured for name in MEASURED},
        "tire_slip": lateral and p.tire_slip != 0.0,
        "slots": lateral or stands or wheels,
    }


NUMBERS = {
    "LATENCY": "s: time stamp of a fix minus the time at which its position was true",
    "QUARTER_GAMMA": "gamma / 4, with gamma^2 = alpha^2 (n + kappa)",
    "SHORTENS": "-8 / gamma^2",
    "SPREAD": "alpha^2 (n + kappa - 1) + beta",
    "ACCEL_BIAS_STD": f"{SENSORS['accel'].unit}: initial standard deviation of the bias",
    "GYRO_BIAS_STD": f"{SENSORS['gyro'].unit}: initial standard deviation of the bias",
    "TILT_STD": "rad: initial standard deviation of roll and pitch",
    "FORGETTING": "forgetting factor per fix",
    "WIDTH_RATIO": 'ratio at which "large" has membership 1',
    "WIDTH_TREND": 'trend at which "rises" has membership 1',
    "GAIN_R": "largest factor of R",
    "GAIN_Q": "largest factor of Q",
    "GATE": "largest normalized innovation squared (NIS) of a fix that is used",
    "ACCURACY_SCALE": "the stated variance of a fix, times this factor, is added to R",
    "FIX_ERROR": "g: variance of the correlated fix error, relative to the stated variance",
    "FIX_ERROR_RATE": "nominal interval / time constant of the correlated fix error",
    "FIX_VAR": "m2: variance of a fix that has no stated standard deviation",
    "ROBUST_DOF": "degrees of freedom of Student's t, the distribution of the errors of fixes",
    "PATIENCE": "nominal steps: shortest run of consecutive outliers after which P is inflated",
    **{noise.upper(): MEASURED[name] for name, noise in NOISE_OF.items()},
    "REAR_AXLE": "m: distance from the rear axle forward to the IMU",
    "TIRE_SLIP": "s2/m: slip angle of the rear tires (rad) per lateral acceleration (m/s2)",
    "PER_ODOMETER_SCALE": "true speed / reading",
    "ODOMETER_LATENCY": "s: time stamp of a reading minus the time of its measurement",
}
"""Comments in the definitions of the numbers that a template may use."""


def with_definitions(text: str, numbers: Mapping[str, str]) -> str:
    """Replace ``@NUMBERS@`` by definitions of those `NUMBERS` that the C text uses but does not define."""
    names = set(re.findall(r"\w+", text)) - set(re.findall(r"#define (\w+)", text))
    used = [name for name in NUMBERS if name in names and name in numbers]
    definitions = [f"#define {name} {numbers[name]} /* {NUMBERS[name]} */" for name in used]
    return text.replace("@NUMBERS@", "\n".join(definitions))


def context_of(p: FilterParameters, interval: float) -> dict[str, Any]:
    """Return the variables that every template may use. Q refers to steps of ``interval`` s."""
    about = {"p": p, "model": MODELS[p.model], "interval": interval}
    about |= {"version": __version__, "description": f"{p.model}, {p.kind}"}
    return features_of(p) | about


def in_range(value: float, of: str) -> float:
    """Return a number. If it is not finite, raise `InputError` with the description ``of``."""
    if not math.isfinite(value):
        raise InputError(
            f"the filter can't be exported: {of} is not a finite number; correct this value, or tune the filter again"
        )
    return value


def initializer(numbers: Iterable[Any], form: str = "R({})") -> str:
    """Return numbers, or rows of numbers, as an initializer in C, with all digits."""
    texts = (initializer(x, form) if np.ndim(x) else form.format(x) for x in numbers)
    return f"{{{', '.join(texts)}}}"


_TEMPLATES = Environment(
    loader=PackageLoader("sigmaswarm.exports"),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_TEMPLATES.filters["initializer"] = initializer


def fill(name: str, context: Mapping[str, Any]) -> str:
    """Fill a template. A missing value raises `jinja2.UndefinedError`."""
    return _TEMPLATES.get_template(name).render(context)
