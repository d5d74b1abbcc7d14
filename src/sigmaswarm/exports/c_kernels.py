"""Translate the kernels of a filter to C for its model and parameters."""

# pyright: reportPrivateUsage=false, reportArgumentType=false
# Only this module uses the private parts of kernels outside of their modules.

from collections.abc import Mapping
from typing import Any

from sigmaswarm.drives import events
from sigmaswarm.exports.c_emitter import Elements, Emitter
from sigmaswarm.exports.c_names import FIX_ERROR, PARAMETERS, STATES
from sigmaswarm.filters.compiled import (
    adaptive,
    fix_error,
    lanes,
    measurements,
    planar5,
    planar8,
    step,
    tilted12,
    transition,
    updates,
    vehicle,
)
from sigmaswarm.filters.compiled.layout import MEAN, NAMES, SUMS
from sigmaswarm.filters.fix_error import FILTERS
from sigmaswarm.filters.models import MEASURED, NOISE_OF
from sigmaswarm.filters.parameters import FilterParameters

EVENTS = ("FIX", *map(str.upper, MEASURED))
"""Names of the bits of `drives.events` in C. An exported filter defines only those that its features use."""


def kernels_of(
    p: FilterParameters, features: Mapping[str, bool], values: Mapping[str, str]
) -> dict[str, str]:
    """Return the C text of prediction, measurements and step, as values of the template."""
    model = FILTERS[p.kernel]
    n, tilted = len(model.states), int(model.tilts is not None)
    states = STATES if not model.fix_error else (*STATES[: n - 2], *FIX_ERROR)
    emitter = Emitter(_rows(p, values["Q"] + "[{}]", values["R"] + "[{}]", features), states)
    emitter.add(lanes._series, "sine_series")
    emitter.add(lanes._near, "sine_cosine_near")
    emitter.add(lanes.sincos, "sine_cosine")
    if features["USE_SCALAR"]:
        emitter.add(updates.update_scalar, n=n)
    if tilted:
        _add_tilted(emitter, features, n)
    else:
        if p.kind != "ekf":
            emitter.add(lanes.spread_of)
        _add_planar(emitter, p.model, features, n)
    both = {"n": n, "tilted": tilted}
    if features["USE_HEADING"]:
        measure = tilted12.measure_heading_tilted if tilted else vehicle.measure_heading_planar
        emitter.add(measure, "measure_heading", n=n)
        emitter.add(vehicle.update_heading, tilted=tilted, measure_heading=measure)
    if model.fix_error:
        _add_fix_error(emitter, n, features)
    emitter.add(updates.update_pair, **both, fold=tilted12.fold)
    if features["USE_VELOCITY_OR_STANDSTILL"]:
        emitter.add(vehicle.take_velocity, n=n, update_pair=updates.update_pair)
    if features["USE_VELOCITY"]:
        emitter.add(vehicle.update_velocity)
    if features["USE_STANDSTILL"]:
        gyro = tuple(model.gyro_axes.values())
        emitter.add(vehicle.update_standstill, **both, gyro_biases=gyro)
    emitter.add(measurements._keep_digits, **both, unscented=0, fix_error=int(model.fix_error))
    if features["USE_STRETCH"]:
        emitter.add(adaptive.inflate_observed, n=n)
    if features["USE_STRONG_TRACKING"]:
        emitter.add(adaptive.strong_tracking, n=n)
    if features["USE_ROBUST"]:
        emitter.add(adaptive.student_t_weight)
    if features["USE_ADAPTIVE"]:
        emitter.add(adaptive.adapt, n=n)
    if features["USE_FUZZY"]:
        emitter.add(adaptive.apply_fuzzy_rules, n=n)
    _add_step(emitter, p, features)
    kernels, stepping = emitter.texts[:-1], emitter.texts[-1]
    emitter.texts = kernels
    bits = [f"#define EVENT_{name} {getattr(events, name)}u\n" for name in _events(features)]
    wheels = "&wheels" if features["USE_ODOMETER"] else "NULL"
    parts = {"EVENTS": "".join(bits), "STEP": stepping, "CALL_STEP": emitter.call("_step"), "WHEELS": wheels}
    return {"KERNELS": emitter.text(), **parts}


def _events(features: Mapping[str, bool]) -> list[str]:
    return [name for name in EVENTS if features.get(f"USE_{name}", True)]


def _add_step(emitter: Emitter, p: FilterParameters, features: Mapping[str, bool]) -> None:
    model = FILTERS[p.kernel]
    stores_innovation = features["USE_NIS"] or features["USE_LANES"]
    if stores_innovation:
        emitter.add(measurements._add_likelihood)
    emitter.add(
        measurements.update_fix,
        **{
            "stores_innovation": stores_innovation,
            "gated": features["USE_GATE"],
            "adaptive": 1,
            "note_prior": 0,
        },
        **{"fading": features["USE_STRONG_TRACKING"], "fuzzy": features["USE_FUZZY"]},
        **{"robust": features["USE_ROBUST"], "adapting": features["USE_ADAPTIVE"]},
        fix_error=model.fix_error,
        _measure_fix=tilted12.measure_fix_tilted if model.tilts else measurements._measure_fix,
    )
    emitter.add(step._grow, tilted=int(model.tilts is not None))
    if model.tilts:  # the template contains the order of the prediction
        state, sample = ["InsGpsEstimate *b", "Work *work"], [*PARAMETERS["u"]]
        emitter.signatures["predict_tilted12"] = "predict_tilted12", [state, sample]
    absent = {name: 0 for name in (*EVENTS, "HIDDEN") if name not in _events(features)}
    emitter.add(
        step._step,
        predict=step._PREDICTIONS[p.model][0],
        carry=fix_error.carry if features["USE_PLANAR_FIX_ERROR"] else 0,
        grow=step._grow,
        **{function.__name__: function for function in measurements.UPDATES},
        **{"settle": 0, "note_prior": 0},
        **absent,
    )


def _add_planar(emitter: Emitter, model: str, features: Mapping[str, bool], n: int) -> None:
    if model == "planar5":
        emitter.add(lanes.sinc_cos)
        emitter.add(planar5._refresh_sin_cos)
        emitter.add(planar5._invalidate_sin_cos)
        emitter.add(planar5._turn, "turn_acceleration")
        emitter.add(planar5.predict_planar5)
    else:
        emitter.add(planar8._turn, "turn_acceleration")
        emitter.add(planar8.predict_planar8)
    emitter.add(measurements._turn_lever)
    emitter.add(measurements._measure_fix, n=n)
    has_biases = features["USE_BIASES"]
    along = vehicle.measure_along_planar
    if features["USE_LATERAL"]:
        emitter.add(along, "measure_lateral", n=n, lateral=1, bias=MEAN.index("W") if has_biases else -1)
        emitter.add(vehicle.update_lateral, tilted=0, measure_lateral=along)
    if features["USE_ODOMETER"]:
        emitter.add(along, "measure_odometer", n=n, lateral=0, bias=MEAN.index("A") if has_biases else -1)
        emitter.add(vehicle.update_odometer, tilted=0, measure_odometer=along)


def _add_fix_error(emitter: Emitter, n: int, features: Mapping[str, bool]) -> None:
    if not features["USE_TILTED"]:
        emitter.add(fix_error.carry, "carry_fix_error", n=n, biases=int(features["USE_BIASES"]))
    emitter.add(fix_error.age_fix_error)
    emitter.add(fix_error.move_fix_error, n=n, noted=0)
    emitter.add(fix_error.observe_fix_error, n=n)


def _add_tilted(emitter: Emitter, features: Mapping[str, bool], n: int) -> None:
    for function in (lanes.sinc_cos, tilted12._turn_far, tilted12._half_turn, tilted12._move, tilted12.fold):
        emitter.add(function)
    coefficients = [f"work->{NAMES[row].lower()}" for row in transition.COEFFICIENTS["tilted12"]]
    emitter.add(
        transition.tilted12,
        "propagate_error",
        f=Elements("const Work *work", coefficients),
        e=Elements("real *e", [f"e[{state}]" for state in STATES[: -len(FIX_ERROR)]]),
    )
    emitter.add(tilted12.measure_fix_tilted, "measure_fix", n=n)
    along = tilted12.measure_along_tilted
    if features["USE_LATERAL"]:
        emitter.add(along, "measure_lateral", n=n, **tilted12.ALONG["lateral"])
        emitter.add(vehicle.update_lateral, tilted=1, measure_lateral=along)
    if features["USE_ODOMETER"]:
        emitter.add(along, "measure_odometer", n=n, **tilted12.ALONG["odometer"])
        emitter.add(vehicle.update_odometer, tilted=1, measure_odometer=along)


def _rows(p: FilterParameters, q: str, r: str, features: Mapping[str, bool]) -> dict[str, str | float | None]:
    spread, fuzzy = p.kind != "ekf", p.kind == "fuzzy-ukf"
    if p.kind == "adaptive-ukf":
        q, r = "b->process_noise[{}]", "b->measurement_noise[{}]"
    elif fuzzy:
        q, r = f"(b->times_q * {q})", f"b->times_r * {r}"
    turns_along = p.model == "planar5"
    accuracy = "b->times_r * ACCURACY_SCALE" if fuzzy else "ACCURACY_SCALE"
    rows: dict[str, Any] = {
        **{name: name if spread else 0.0 for name in ("QUARTER_GAMMA", "SHORTENS", "SPREAD")},
        "SECOND": float(spread),
        "Q": q,
        **{f"Q_{letter}": q.format(state) for letter, state in zip(MEAN, STATES, strict=True)},
        "RX": r.format(0),
        "RY": r.format(1),
        "ACCURACY": 0.0 if p.accuracy_scale is None else accuracy,
        "LATENCY": "LATENCY" if p.latency else 0.0,
        **{f"R_{name.upper()}": noise.upper() for name, noise in NOISE_OF.items()},
        "REAR_AXLE": "REAR_AXLE",
        "TIRE_SLIP": "TIRE_SLIP" if features["USE_SLIP"] else 0.0,
        "R_RATE": "STANDSTILL_RATE_NOISE",
        "ODOMETER_SCALE": "PER_ODOMETER_SCALE",
        "ODOMETER_LATENCY": "ODOMETER_LATENCY",
        **{"FORGETTING": "FORGETTING", "FADING": "FORGETTING", "RECENT": "b->recent"},
        **{"GATE": "GATE", "REJECTED": "b->rejected"},
        **{"FUZZY": "FORGETTING", "QUICK": "b->quick", "SLOW": "b->slow"},
        **{"TIMES_R": "b->times_r", "TIMES_Q": "b->times_q"},
        **{name: name for name in ("WIDTH_RATIO", "WIDTH_TREND", "GAIN_R", "GAIN_Q")},
        **dict.fromkeys(SUMS[: SUMS.index("OK")]),  # scores, which C does not have
        **{"DOF": "ROBUST_DOF", "PATIENCE": "PATIENCE", "OUTLIERS": "b->outliers", "SPAN": "b->span"},
        "OK": "b->failed",
        **{name: name for name in ("FIX_ERROR", "FIX_ERROR_RATE", "FIX_VAR")},
        **dict.fromkeys(("SIN_COS_VALID", "SIN_COS_VALID_ALL"), "b->faced" if turns_along else None),
        **dict.fromkeys(("TINY", "GRAVITY")),
    }
    memory = "b" if turns_along else "work"
    rows |= {"COS": f"{memory}->cos", "SIN": f"{memory}->sin"}
    if not features["USE_GATE"]:
        rows["USE"] = 1.0
    if not (features["USE_LANES"] or fuzzy):
        rows |= dict.fromkeys(("V11", "V12", "V22"))
    if not features["USE_LANES"]:
        rows |= dict.fromkeys(("NU1", "NU2"))
    return rows
