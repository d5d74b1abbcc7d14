"""Values of the templates of exported filters: the parts that a filter uses, and its numbers."""

import math
from collections.abc import Iterable

from sigmaswarm.drives import odometer, timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters import fuzzy, schedule, student, tilted
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.versions import __version__


def features_of(p: FilterParameters) -> dict[str, bool]:
    """Which parts of the templates a filter needs."""
    velocity, lateral, stands, wheels = schedule.switches(p)
    has_tilts = MODELS[p.model].tilts is not None
    biases, gate = bool(MODELS[p.model].sensors), p.gate is not None
    adaptive, tracking = p.kind == "adaptive-ukf", p.kind == "strong-tracking-ukf"
    rules = p.kind == "fuzzy-ukf"
    used = {
        "UNSCENTED": p.kind != "ekf",
        "TILTED": has_tilts,
        "PLANAR5": p.model == "planar5",
        "BIASES": biases,
        "ADAPTIVE": adaptive,
        "STRONG_TRACKING": tracking,
        "FUZZY": rules,
        "FORGETTING": adaptive or tracking or rules,
        "LATENCY": p.latency != 0.0,
        "GATE": gate,
        "NIS": gate or rules,
        "GATE_OR_STRETCH": gate or tracking or rules or p.robust_dof is not None,
        "ACCURACY": p.accuracy_scale is not None,
        "FIX_ERROR": p.fix_error is not None,
        "PLANAR_FIX_ERROR": p.fix_error is not None and not has_tilts,
        "STD": p.accuracy_scale is not None or p.fix_error is not None,
        "SINCE": adaptive or p.fix_error is not None,
        "ROBUST": p.robust_dof is not None,
        "STRETCH": tracking or p.robust_dof is not None,
        "VELOCITY": velocity,
        "LATERAL": lateral,
        "SLIP": lateral and p.tire_slip != 0.0,
        "STANDSTILL": stands,
        "VELOCITY_OR_STANDSTILL": velocity or stands,
        "LATERAL_OR_STANDSTILL": lateral or stands,
        "ODOMETER": wheels,
        "ALONG": lateral or wheels,
        "SLOTS": lateral or stands or wheels,
        "SCALAR": lateral or wheels or (stands and biases),
    }
    return {f"USE_{name}": value for name, value in used.items()}


def values_of(p: FilterParameters, interval: float) -> dict[str, str]:
    """A filter's parameters as text; ``interval`` (s) is that of Q."""
    numbers: dict[str, float | None] = {
        "NOMINAL_INTERVAL": interval,
        "LATENCY": p.latency,
        "ALPHA": p.alpha,
        "BETA": p.beta,
        "KAPPA": p.kappa,
        "ACCEL_BIAS_STD": p.bias_std[0],
        "GYRO_BIAS_STD": p.bias_std[1],
        "FORGETTING": p.forgetting,
        "FUZZY_WIDTH_RATIO": p.fuzzy_widths[0],
        "FUZZY_WIDTH_TREND": p.fuzzy_widths[1],
        "FUZZY_GAIN_R": p.fuzzy_gains[0],
        "FUZZY_GAIN_Q": p.fuzzy_gains[1],
        "LARGEST_RATIO": fuzzy.LARGEST_RATIO,
        "SLOWER": fuzzy.SLOWER,
        "GATE": p.gate,
        "ACCURACY_SCALE": p.accuracy_scale,
        "ROBUST_DOF": p.robust_dof,
        "FIX_ERROR": p.fix_error,
        "FIX_ERROR_RATE": interval / p.fix_error_time,
        "FIX_VAR": p.fix_std**2,
        "FIX_ERROR_START": (p.fix_error or 0.0) * p.fix_std**2,
        "OUTLYING": student.OUTLYING,
        "OUTLIERS_SPAN": student.OUTLIERS_SPAN,
        "VELOCITY_NOISE": p.velocity_noise,
        "LATERAL_NOISE": p.lateral_noise,
        "REAR_AXLE": p.rear_axle,
        "TIRE_SLIP": p.tire_slip,
        "LATERAL_INTERVAL": schedule.LATERAL_INTERVAL,
        "CORNERING": timeline.CORNERING,
        "STANDSTILL_NOISE": p.standstill_noise,
        "STANDSTILL_INTERVAL": schedule.STANDSTILL_INTERVAL,
        "STANDSTILL_RATE_NOISE": schedule.STANDSTILL_RATE_NOISE,
        "ODOMETER_NOISE": p.odometer_noise,
        "ODOMETER_SCALE": p.odometer_scale,
        "ODOMETER_LATENCY": p.odometer_latency,
        "ODOMETER_INTERVAL": odometer.INTERVAL,
        "SLOW": odometer.SLOW,
        "STALE": odometer.STALE,
        "SLIP_GATE": schedule.SLIP_GATE,
        "TILT_STD": max(state.start_std for state in MODELS[p.model].states),
        "GRAVITY": tilted.GRAVITY,
    }
    return plain(numbers) | {
        "VERSION": __version__,
        "DESCRIPTION": f"{p.model}, {p.kind}",
        "MODEL": p.model,
        "BELIEF_STATES": "INS_GPS_STATES" if p.fix_error is None else "INS_GPS_STATES + 2",
        "N": "INS_GPS_STATES" if p.fix_error is None else "(INS_GPS_STATES + 2)",
        "MOST_REJECTED": str(schedule.MOST_REJECTED),
        "ITERATIONS": str(student.ITERATIONS),
        "OUTLIERS": str(student.OUTLIERS),
    }


def in_range(value: float, of: str) -> float:
    """Check a number that is computed from a filter's parameters.

    Raises
    ------
    InputError
        If it is beyond the range of floating point; ``of`` says what it is made of.
    """
    if not math.isfinite(value):
        raise InputError(
            f"the filter can't be handed over: {of} is beyond the range of numbers; tune it again or correct it"
        )
    return value


def plain(numbers: dict[str, float | None]) -> dict[str, str]:
    """Numbers as text that keeps every bit; None is left out."""
    return {name: repr(float(value)) for name, value in numbers.items() if value is not None}


def listed(numbers: Iterable[float], form: str = "{}") -> str:
    """Numbers with commas in between."""
    return ", ".join(form.format(repr(float(number))) for number in numbers)
