"""Translate the fit of an alignment from the library's functions to C99, always in double."""

# pyright: reportPrivateUsage=false

import re
from collections.abc import Sequence
from typing import Any, ClassVar

from sigmaswarm.drives import alignment, alignment_fit, gyro_bias, tilt_evidence
from sigmaswarm.exports.c_emitter import Emitter
from sigmaswarm.exports.c_names import STATES
from sigmaswarm.exports.c_rules import Rule
from sigmaswarm.filters import divergence
from sigmaswarm.filters.compiled import live, monitor
from sigmaswarm.filters.tilted import add_tilt_evidence

MODULES = alignment, alignment_fit, gyro_bias, tilt_evidence, divergence, monitor, live
"""Modules that define constants of the C text."""
_FIX = ("motion.time", "x", "y", "motion.turned", "motion.gained", "motion.leaned[0]", "motion.leaned[1]")
_NUMBERS = (
    *(f"{name}[{k}]" for name in ("force", "force_variance", "turn", "drift") for k in range(2)),
    *("speed", "assumed", "assumed_variance", "change[0]"),
)


class _OfFit(Rule):
    """Translation of a function on fixes, paths and matrices."""

    times, enumerators = (), dict[str, str]()
    fields: ClassVar = {
        **dict.fromkeys(("fix", "fixes"), (*_FIX, "motion.lateral")),
        **dict.fromkeys(("tilt", "seen"), _NUMBERS),
    }
    pointers: ClassVar = {
        **dict.fromkeys(("fix", "fixes"), "const InsGpsAlignFix *"),
        **dict.fromkeys(("covariance", "inverse", "matrix"), "real [][5]"),
        **{"path": f"real [][{alignment_fit.COLUMNS}]", "rows": "real [][6]", "tilt": "InsGpsGyro *"},
    }


class _OfFilter(_OfFit):
    """Translation of a function on the state of a filter, with the names that states have in ins_gps.c."""

    enumerators: ClassVar = {"THETA": "HEADING", **{name: name for name in STATES}}
    pointers: ClassVar = {
        **dict.fromkeys(("observed", "unsure", "turns"), "const real *"),
        **{"covariance": "real [][N]", "seen": "const InsGpsGyro *", "indices": "const int *"},
    }


class _OfMonitor(_OfFit):
    """Translation of a rule of the divergence monitor."""

    enumerators: ClassVar = {"THETA": "INS_GPS_HEADING"}
    fields: ClassVar = {"contradiction": ("checks", "since", "last")}
    pointers: ClassVar = {
        **dict.fromkeys(("fix", "variance", "lever"), "const real *"),
        **{"mean": "const ins_gps_real *", "covariance": "ins_gps_real [][INS_GPS_STATES]"},
        "contradiction": "InsGpsContradiction *",
    }


def alignment_of(*, biases: bool, tilted: bool) -> dict[str, str]:
    """Return C text by name: the fit, the update of a filter with its evidence, and rules of the divergence monitor."""
    fit = [alignment_fit.turn_path, alignment_fit.fit_path, alignment_fit.convert_to_start]
    fit += [tilt_evidence.mean_forces] if tilted else []
    evidence = [*((gyro_bias.mix_biases, gyro_bias.update_biases) if biases else ())]
    evidence += [add_tilt_evidence] if tilted else []
    checks = (divergence.record_check, divergence.persists, divergence.position_contradicts)
    parts = ("alignment", _OfFit, fit), ("evidence", _OfFilter, evidence), ("monitor", _OfMonitor, checks)
    return {name: _in_double(translation, functions) for name, translation, functions in parts}


def _in_double(translation: type[Rule], functions: Sequence[Any]) -> str:
    emitter = Emitter({})
    for function in functions:
        emitter.add(function, translation=translation)
    text = re.sub(r"\bR\(([\w.+-]+)\)", r"\1", "\n".join(emitter.texts))
    text = re.sub(r"\b(SIN|COS|SQRT|HYPOT|ATAN2|FABS|EXP|LOG)\b", lambda name: name[0].lower(), text)
    return re.sub(r"\breal\b", "double", text).replace("LARGER", "fmax").replace("SMALLER", "fmin")
