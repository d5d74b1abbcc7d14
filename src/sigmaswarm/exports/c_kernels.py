"""Translate the kernels of a filter to C for its model and parameters."""

# pyright: reportPrivateUsage=false, reportArgumentType=false

from collections.abc import Mapping
from typing import Any

from sigmaswarm.drives import events, tilt_evidence
from sigmaswarm.exports.c_emitter import FIX_ERROR, PARAMETERS, STATES, Elements, Emitter
from sigmaswarm.exports.c_functions import Function
from sigmaswarm.filters import constants
from sigmaswarm.filters.compiled import (
    adaptive,
    lanes,
    live,
    step,
    swarm,
    tilted12,
    transition,
    vehicle,
)
from sigmaswarm.filters.compiled.layout import CONSTANTS, MEAN, NAMES, SUMS
from sigmaswarm.filters.compiled.unroll import Kernel
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import MEASURED, NOISE_OF
from sigmaswarm.filters.parameters import FilterParameters

MODULES = lanes, vehicle, constants, tilt_evidence, live, swarm
"""Modules with constants of the kernels and the template."""
EVENTS = ("FIX", *map(str.upper, MEASURED))
"""Names of the bits of `drives.events` in C. An exported filter defines only those that its features use."""
NAMES_IN_C = {
    "_series": "sine_series",
    "_near": "sine_cosine_near",
    "sincos": "sine_cosine",
    "_turn": "turn_acceleration",
    "carry": "carry_fix_error",
}


def kernels_of(p: FilterParameters, context: Mapping[str, Any]) -> dict[str, Any]:
    """Return the C text of prediction, measurements and step, and the bits of the events that the filter uses."""
    model = FILTERS[p.kernel]
    n = len(model.states)
    states = STATES if not model.fix_error else (*STATES[: n - 2], *FIX_ERROR)
    used = [name for name in EVENTS if context.get(name.lower(), True)]
    lanes = context["lanes"] > 1
    settings = {
        **{name: 0 for name in (*EVENTS, "HIDDEN") if name not in used},
        **dict.fromkeys(("settle", "note_prior", "unscented", "noted"), 0),
        "adaptive": 1,
        "stores_innovation": context["nis"] or lanes,
        "gated": context["gate"],
        "fading": context["strong_tracking"],
        "fuzzy": context["fuzzy"],
        "robust": context["robust"],
        "adapting": context["adaptive"],
        "inflate_observed": Kernel(adaptive.inflate_observed, n=n),
    }
    rows = _rows(p, context)
    emitter = Emitter(Function, rows, states, settings, {**NAMES_IN_C, "predict": f"predict_{p.model}"})
    if model.tilts:
        _add_prediction(emitter)
    emitter.add(step.step_of(p.kernel))
    emitter.texts, stepping = emitter.texts[:-1], emitter.texts[-1]
    bits = [(name, getattr(events, name)) for name in used]
    return {"kernels": emitter.text(), "events": bits, "step": stepping, "call_step": emitter.call("_step")}


def _add_prediction(emitter: Emitter) -> None:
    """Add the functions that ``predict_tilted12`` in the template calls."""
    for function in (tilted12._half_turn, tilted12._move):
        emitter.add(function)
    coefficients = [f"work->{NAMES[row].lower()}" for row in transition.COEFFICIENTS["tilted12"]]
    emitter.add(
        transition.tilted12,
        "propagate_error",
        f=Elements("const Work *work", coefficients),
        e=Elements("real *e", [f"e[{state}]" for state in STATES[: -len(FIX_ERROR)]]),
    )
    state, sample = ["InsGpsEstimate *b", "Work *work"], [*PARAMETERS["u"]]
    emitter.signatures["predict"] = "predict_tilted12", [state, sample]


def _rows(p: FilterParameters, context: Mapping[str, Any]) -> dict[str, str | float | None]:
    spread, fuzzy, lanes = context["unscented"], context["fuzzy"], context["lanes"] > 1
    q, r = f"{context['q']}[{{}}]", f"{context['r']}[{{}}]"
    if context["adaptive"]:
        q, r = "b->process_noise[{}]", "b->measurement_noise[{}]"
    elif fuzzy:
        q, r = f"(b->times_q * {q})", f"b->times_r * {r}"
    turns_along = p.model == "planar5"
    accuracy = "b->times_r * ACCURACY_SCALE" if fuzzy else "ACCURACY_SCALE"
    rows: dict[str, Any] = {
        **{name: name for name in CONSTANTS},  # macros
        **{name: f"b->{name.lower()}" for name in SUMS[SUMS.index("REJECTED") : SUMS.index("HEADING")]},
        **{f"R_{name.upper()}": noise.upper() for name, noise in NOISE_OF.items()},
        **{f"Q_{letter}": q.format(state) for letter, state in zip(MEAN, STATES, strict=True)},
        **dict.fromkeys(SUMS[: SUMS.index("OK")]),  # sums for scores, which C does not compute
        **dict.fromkeys(("SIN_COS_VALID", "SIN_COS_VALID_ALL"), "b->faced" if turns_along else None),
        "Q": q,
        "RX": r.format(0),
        "RY": r.format(1),
        "R_RATE": "R(STANDSTILL_RATE_NOISE)",
        "SECOND": float(spread),
        "ODOMETER_SCALE": "PER_ODOMETER_SCALE",
        "ACCURACY": 0.0 if p.accuracy_scale is None else accuracy,
        "FADING": "FORGETTING",
        "FUZZY": "FORGETTING",
        "DOF": "ROBUST_DOF",
        "OK": "b->failed",
    }
    if not spread:
        rows |= dict.fromkeys(("QUARTER_GAMMA", "SHORTENS", "SPREAD"), 0.0)
    rows |= {name: 0.0 for name in ("LATENCY", "TIRE_SLIP") if not context[name.lower()]}
    memory = "b" if turns_along else "work"
    rows |= {"COS": f"{memory}->cos", "SIN": f"{memory}->sin"}
    if not context["gate"]:
        rows["USE"] = 1.0
    if not (lanes or fuzzy):
        rows |= dict.fromkeys(("V11", "V12", "V22"))
    if not lanes:
        rows |= dict.fromkeys(("NU1", "NU2"))
    return rows
