"""Translate functions of sigmaswarm to C99 for one filter, without terms that are 0 in this filter."""

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from sigmaswarm.drives import timeline
from sigmaswarm.filters.compiled.layout import NAMES
from sigmaswarm.filters.compiled.unroll import Kernel

STATES = (
    "X", "Y", "VX", "VY", "HEADING", "ACCEL_X", "ACCEL_Y", "GYRO", "ROLL", "PITCH", "GYRO_X", "GYRO_Y",
    "FIX_ERROR_X", "FIX_ERROR_Y",
)  # fmt: skip
"""Names of the states in C, in the order of the largest model."""
FIX_ERROR = STATES[-2:]
PARAMETERS = {
    "w": ("InsGpsEstimate *b", "Work *work"),
    "u": ("real dt", "real steps", "const InsGpsSample *sample"),
    "z": ("const InsGpsFix *fix",),
    "lever": ("const real *lever",),
    "wheels": ("const Wheels *wheels",),
    "events": ("unsigned events",),
    "since": ("InsGpsEstimate *b",),
    "l": (),
}
"""C parameters that replace a parameter of a kernel. A C function has only the parameters that it uses."""
WHEELS = ("speed", "age", "more")
"""Fields of an odometer measurement, in the order of `drives.odometer`."""
_AXES = ["yaw_rate" if axis == "gz" else axis for axis in timeline.AXES]
INPUTS = {
    "u": {
        timeline.DT: "dt",
        timeline.Q_SCALE: "steps",
        timeline.GAP: "sample->gap",
        **{k: f"sample->{axis}" for k, axis in enumerate(_AXES, timeline.FIRST_AXIS)},
    },
    "z": {
        timeline.FIX_X: "(fix->x - b->origin[0])",
        timeline.FIX_Y: "(fix->y - b->origin[1])",
        timeline.FIX_VX: "fix->vx",
        timeline.FIX_VY: "fix->vy",
        timeline.FIX_VAR_X: "fix->variance[0]",
        timeline.FIX_VAR_Y: "fix->variance[1]",
        timeline.FIX_THETA: "fix->heading",
        timeline.FIX_VAR_THETA: "fix->heading_variance",
    },
    "wheels": {k: f"wheels->{name}" for k, name in enumerate(WHEELS)},
    "lever": {k: f"lever[{k}]" for k in range(3)},
}
"""C text of the elements of a step, a fix, an odometer measurement and the lever arm."""
_FUNCTIONS = ("SIN", "COS", "SQRT", "HYPOT", "EXP", "LOG", "FLOOR")
CALLS = {
    **{f"{module}.{name.lower()}": name for module in ("np", "math") for name in _FUNCTIONS},
    "abs": "FABS",
    "angle_of": "ATAN2",
    "np.arctan2": "ATAN2",
}
RENAMED = {"_": "again", "b": "b0", "since": "b->steps_since_fix", "near": "is_near", "far": "is_far"}
"""C names of Python names that are reserved or stored elsewhere in C."""


def parameter_name(parameter: str) -> str:
    """Return the name of a C parameter, for example ``rows`` of ``real rows[][6]``."""
    return parameter.split()[-1].lstrip("*").partition("[")[0]


class Elements(NamedTuple):
    """An array that a function unpacks: the C parameter, and the C text of each element."""

    parameter: str
    texts: Sequence[str]


class Translated(Protocol):
    def text(self) -> str: ...


Translation = Callable[["Emitter", Any, str, dict[str, Any]], Translated]
"""Arguments: emitter, function, name in calls, and the values of parameters and globals by name."""


class Emitter:
    """C functions of one filter.

    Parameters
    ----------
    translation : callable
        Class that translates a function, for example `c_functions.Function`.
    rows : dict
        Rows of the kernel array by name: C text, a number, or None if the C code does not contain the row.
    states : sequence of str
        C names of the filter's states.
    settings : dict
        Values of parameters and globals, by name, in all functions.
    names : dict of str to str
        C names of functions by Python name; all other functions keep their names.
    """

    def __init__(
        self,
        translation: Translation,
        rows: Mapping[str, str | float | None] | None = None,
        states: Sequence[str] = STATES,
        settings: Mapping[str, Any] | None = None,
        names: Mapping[str, str] | None = None,
    ) -> None:
        self.translation, self.rows, self.states, self.texts = translation, rows or {}, states, list[str]()
        self.settings, self.names = settings or {}, names or {}
        self.signatures: dict[str, tuple[str, list[list[str]]]] = {}  # by name in Python

    def add(
        self, function: Any, name: str = "", translation: Translation | None = None, **known: Any
    ) -> None:
        """Translate a kernel or a plain function, after the functions that it calls.

        ``name`` is the name in calls, by default that of the function. ``known`` contains the values of parameters. If
        ``known["e"]`` is an `Elements`, the function writes its results to these elements.
        """
        if isinstance(function, Kernel):
            function, known = function.source, {**function.known, **known}
        absent = {parameter: 0 for parameter, value in known.items() if value is None}
        known = {**known, **absent, **self.settings}
        translated = (translation or self.translation)(self, function, name or function.__name__, known)
        self.texts.append(translated.text())

    def signature_of(self, name: str, function: Any) -> tuple[str, list[list[str]]]:
        """Return the C name and parameters of a called function, which is translated at its first call.

        ``name`` is the function's name in the call.
        """
        if name not in self.signatures:
            self.add(function, name)
        return self.signatures[name]

    def call(self, function: str) -> str:
        name, signature = self.signatures[function]
        parameters = dict.fromkeys(parameter_name(p) for each in signature for p in each)
        return f"{name}({', '.join(parameters)})"

    def text(self) -> str:
        code = re.sub(r"/\*.*?\*/", "", "\n".join(self.texts), flags=re.DOTALL)
        rows = set(re.findall(r"work->(\w+)", code))
        names = [row.lower() for row in NAMES if row.lower() in rows]
        names += [f"{block}[N]" for block in ("C1", "C2") if block in rows]
        listed = textwrap.fill(", ".join(names), 110, subsequent_indent=" " * 9)
        struct = f"typedef struct {{\n    real {listed};\n}} Work;\n"
        return "\n".join([struct, *self.texts])
