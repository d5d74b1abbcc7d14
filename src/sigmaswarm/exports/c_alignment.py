"""Translate the alignment and the rules of the divergence monitor to C99. The C code always uses double."""

# pyright: reportPrivateUsage=false

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar

from sigmaswarm.drives import alignment, alignment_fit, gyro_bias, tilt_evidence
from sigmaswarm.exports.c_emitter import STATES, Emitter
from sigmaswarm.exports.c_rules import Rule, by_name
from sigmaswarm.filters import divergence
from sigmaswarm.filters.compiled import live, monitor
from sigmaswarm.filters.tilted import add_tilt_evidence

MODULES = alignment, alignment_fit, gyro_bias, tilt_evidence, divergence, monitor, live
"""Modules that define constants of the C text."""
_FIX = (
    "motion.time", "x", "y", "motion.turned", "motion.gained", "motion.leaned[0]", "motion.leaned[1]", "motion.lateral",
)  # fmt: skip
_GYRO = (
    "force[0]", "force[1]", "force_variance[0]", "force_variance[1]", "turn[0]", "turn[1]", "drift[0]", "drift[1]",
    "speed", "assumed", "assumed_variance", "change[0]",
)  # fmt: skip


class _OfFit(Rule):
    """Translation of a function that reads fixes, paths and matrices."""

    times, enumerators = (), dict[str, str]()
    fields: ClassVar = {"fix": _FIX, "fixes": _FIX, "tilt": _GYRO, "seen": _GYRO}
    pointers: ClassVar = by_name(
        {
            "const InsGpsAlignFix *": "fix fixes",
            "real [][5]": "covariance inverse matrix",
            f"real [][{alignment_fit.COLUMNS}]": "path",
            "real [][6]": "rows",
            "InsGpsGyro *": "tilt",
        }
    )


class _OfFilter(_OfFit):
    """Translation of a function that changes the state of a filter; the states have their names in ins_gps.c."""

    enumerators: ClassVar = {"THETA": "HEADING", **{name: name for name in STATES}}
    pointers: ClassVar = by_name(
        {
            "const real *": "observed unsure turns",
            "real [][N]": "covariance",
            "const InsGpsGyro *": "seen",
            "const int *": "indices",
        }
    )


class _OfMonitor(_OfFit):
    """Translation of a rule of the divergence monitor."""

    enumerators: ClassVar = {"THETA": "INS_GPS_HEADING"}
    fields: ClassVar = {"contradiction": ("checks", "since", "last")}
    pointers: ClassVar = by_name(
        {
            "const real *": "fix variance lever",
            "const ins_gps_real *": "mean",
            "ins_gps_real [][INS_GPS_STATES]": "covariance",
            "InsGpsContradiction *": "contradiction",
        }
    )


@cache
def alignment_of(*, biases: bool, tilted: bool) -> dict[str, str]:
    """Return C text by name: the fit, the update of a filter with evidence, and the rules of the divergence monitor."""
    fit = [alignment_fit.turn_path, alignment_fit.fit_path, alignment_fit.convert_to_start]
    fit += [tilt_evidence.mean_forces] if tilted else []
    evidence = [*((gyro_bias.mix_biases, gyro_bias.update_biases) if biases else ())]
    evidence += [add_tilt_evidence] if tilted else []
    checks = (divergence.record_check, divergence.persists, divergence.position_contradicts)
    parts = ("alignment", _OfFit, fit), ("evidence", _OfFilter, evidence), ("monitor", _OfMonitor, checks)
    return {name: _in_double(translation, functions) for name, translation, functions in parts}


def _in_double(translation: type[Rule], functions: Sequence[Any]) -> str:
    emitter = Emitter(translation)
    for function in functions:
        emitter.add(function)
    text = re.sub(r"\bR\(([\w.+-]+)\)", r"\1", "\n".join(emitter.texts))
    text = re.sub(r"\b(SIN|COS|SQRT|HYPOT|ATAN2|FABS|EXP|LOG)\b", lambda name: name[0].lower(), text)
    return re.sub(r"\breal\b", "double", text).replace("LARGER", "fmax").replace("SMALLER", "fmin")
