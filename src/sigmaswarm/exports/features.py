"""Fill the templates of exported files.

``@NAME@`` is replaced by a value. Lines between ``#if FEATURE`` and its ``#else`` or ``#endif`` are kept if the feature
is used. Other ``#if`` lines belong to the C preprocessor.
"""

import math
import re
from collections.abc import Iterable, Mapping
from importlib.resources import files

from sigmaswarm.errors import InputError
from sigmaswarm.filters import requirements
from sigmaswarm.filters.models import MEASURED, MODELS, NOISE_OF, SENSORS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.versions import __version__


def features_of(p: FilterParameters) -> dict[str, bool]:
    measured = requirements.measured_by(p)
    lateral, stands, wheels = (name in measured for name in ("lateral", "standstill", "odometer"))
    gate, robust = p.gate is not None, p.robust_dof is not None
    adaptive, tracking, rules = (p.kind == f"{kind}-ukf" for kind in ("adaptive", "strong-tracking", "fuzzy"))
    used = {
        "UNSCENTED": p.kind != "ekf",
        "TILTED": MODELS[p.model].tilts is not None,
        "PLANAR5": p.model == "planar5",
        "BIASES": bool(MODELS[p.model].sensors),
        "ADAPTIVE": adaptive,
        "STRONG_TRACKING": tracking,
        "FUZZY": rules,
        "LATENCY": p.latency != 0.0,
        "GATE": gate,
        "NIS": gate or rules,
        "ACCURACY": p.accuracy_scale is not None,
        "FIX_ERROR": p.fix_error is not None,
        "STD": p.accuracy_scale is not None or p.fix_error is not None,
        "SINCE": adaptive or robust or p.fix_error is not None,
        "ROBUST": robust,
        **{name.upper(): name in measured for name in MEASURED},
        "SLIP": lateral and p.tire_slip != 0.0,
        "SLOTS": lateral or stands or wheels,
    }
    return {f"USE_{name}": value for name, value in used.items()}


NUMBERS = {
    "LATENCY": "s: delay of a fix: its time stamp minus the time at which the position was true",
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
    "PATIENCE": "smallest number of nominal steps from the first to the last of the OUTLIERS consecutive outliers",
    **{noise.upper(): MEASURED[name] for name, noise in NOISE_OF.items()},
    "REAR_AXLE": "m: distance from the rear axle forward to the IMU",
    "TIRE_SLIP": "s2/m: slip angle of the rear tires (rad) per lateral acceleration (m/s2)",
    "PER_ODOMETER_SCALE": "true speed / reading",
    "ODOMETER_LATENCY": "s: delay of a reading: its time stamp minus the time at which its value was true",
}
"""Comments in the definitions of the numbers that a template may use."""


def with_definitions(text: str, numbers: Mapping[str, str]) -> str:
    """Replace ``@NUMBERS@`` by definitions of those `NUMBERS` that the C text uses but does not define."""
    names = set(re.findall(r"\w+", text)) - set(re.findall(r"#define (\w+)", text))
    used = [name for name in NUMBERS if name in names and name in numbers]
    definitions = [f"#define {name} {numbers[name]} /* {NUMBERS[name]} */" for name in used]
    return text.replace("@NUMBERS@", "\n".join(definitions))


def values_of(p: FilterParameters, interval: float) -> dict[str, str]:
    """Return parameters and constants as text, by name. Q refers to steps of ``interval`` s."""
    states = "INS_GPS_STATES" if p.fix_error is None else "INS_GPS_STATES + 2"
    texts = {"VERSION": __version__, "DESCRIPTION": f"{p.model}, {p.kind}"}
    texts |= {"BELIEF_STATES": states, "N": states if p.fix_error is None else f"({states})"}
    numbers = exact_texts(
        {
            **{name.upper(): value for name, value in vars(p).items() if isinstance(value, float)},
            "NOMINAL_INTERVAL": interval,
            **dict(zip(("ACCEL_BIAS_STD", "GYRO_BIAS_STD"), p.bias_std, strict=True)),
            **dict(zip(("WIDTH_RATIO", "WIDTH_TREND"), p.fuzzy_widths, strict=True)),
            **dict(zip(("GAIN_R", "GAIN_Q"), p.fuzzy_gains, strict=True)),
            "TILT_STD": max(state.start_std for state in MODELS[p.model].states),
            "FIX_ERROR_START": (p.fix_error or 0.0) * p.fix_std**2,
        }
    )
    return numbers | texts | {"NUMBERS": "@NUMBERS@", "CONSTANTS": "@CONSTANTS@"}


def in_range(value: float, of: str) -> float:
    """Return the number; raise `InputError` with its description ``of`` if it is not finite."""
    if not math.isfinite(value):
        raise InputError(
            f"the filter can't be exported: {of} is not a finite number; correct this value, or tune the filter again"
        )
    return value


def exact_texts(numbers: Mapping[str, float | None]) -> dict[str, str]:
    """Return numbers as exact text; omit None."""
    known = {name: value for name, value in numbers.items() if value is not None}
    return {name: str(v) if isinstance(v, int) else repr(float(v)) for name, v in known.items()}


def listed(numbers: Iterable[float], form: str = "{}") -> str:
    return ", ".join(form.format(repr(float(number))) for number in numbers)


def fill(name: str, features: Mapping[str, bool], values: Mapping[str, str]) -> str:
    """Fill a template. A missing value raises `KeyError`."""
    text = files("sigmaswarm.exports").joinpath("templates", name).read_text(encoding="utf-8")
    return re.sub(r"@([A-Z][A-Z_0-9]*)@", lambda place: values[place[1]], _chosen(text, features))


def _chosen(text: str, features: Mapping[str, bool]) -> str:
    lines: list[str] = []
    open_parts: list[bool | None] = []  # True: used; None: for the C preprocessor
    for line in text.splitlines():
        directive = re.match(r"#\s*(if\w*|else|endif)\b\s*(.*)", line)
        if directive is None:
            chosen = False
        elif directive[1] == "else":
            part = open_parts[-1]
            chosen = part is not None
            open_parts[-1] = None if part is None else not part
        elif directive[1] == "endif":
            chosen = open_parts.pop() is not None
        else:
            open_parts.append(features.get(directive[2]))
            chosen = open_parts[-1] is not None
        if not chosen and False not in open_parts:
            lines.append(line)
    return "\n".join(lines) + "\n"
