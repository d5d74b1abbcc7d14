"""Users' models: states, functions, and the parameters that are tuned."""

import keyword
import math
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import Any, Literal

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.custom.identity import fingerprint

SCALING_NAMES = ("alpha", "beta", "kappa")
"""Scaling of the sigma points, which is searched with the model's parameters for every unscented filter."""


@dataclass(frozen=True)
class Tunable:
    """A parameter that is tuned.

    Attributes
    ----------
    name : str
        f, h and the noises find its value as ``p.name``.
    lowest, highest : float
        Its range.
    logarithmic : bool
        Search it in log10, for values that span powers of ten: variances, time constants.
    unit : str
        Shown in results.
    """

    name: str
    lowest: float
    highest: float
    logarithmic: bool = True
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Model:
    """A user's process and measurement, and the parameters that are tuned in them.

    ``p`` has the values of ``parameters``, each under its name: ``p.length``. Plain functions of numbers and NumPy
    arrays are compiled with Numba; others run too, some hundred times slower.

    Attributes
    ----------
    name : str
    states : tuple of str, length n
    f : callable
        ``f(state, dt, u, p) -> state``: shapes (n,), (n,); dt in s; u (u,) is the log's input.
    h : callable
        ``h(state, p) -> measurement``: shapes (n,), (m,).
    parameters : tuple of Tunable
    process_noise : callable
        ``process_noise(dt, p)``: Q of a step of dt seconds, (n, n), or its diagonal, (n,).
    measurement_noise : callable
        ``measurement_noise(p)``: R, (m, m), or its diagonal, (m,).
    angles : tuple of str
        States that are angles, rad.
    measured_angles : tuple of int
        Which elements of a measurement are angles, rad.
    scored : tuple of str
        States that truth-rmse compares; empty: all whose truth the log has.
    kind : {"ukf", "ekf"}
        Unscented or extended. The extended one takes derivatives by complex steps, so f and h must take complex
        states; it is not compiled.

    Raises
    ------
    InputError
        If a name, a bound or a function can't be used.
    """

    name: str
    states: tuple[str, ...]
    f: Callable[..., Any]
    h: Callable[..., Any]
    parameters: tuple[Tunable, ...]
    process_noise: Callable[..., Any]
    measurement_noise: Callable[..., Any]
    angles: tuple[str, ...] = ()
    measured_angles: tuple[int, ...] = ()
    scored: tuple[str, ...] = ()
    kind: Literal["ukf", "ekf"] = "ukf"

    def __post_init__(self) -> None:
        for field in ("states", "parameters", "angles", "measured_angles", "scored"):
            if isinstance(getattr(self, field), str):
                raise self.wrong(
                    f"{field} = {getattr(self, field)!r} should be a tuple: ({getattr(self, field)!r},)"
                )
            object.__setattr__(self, field, tuple(getattr(self, field)))
        for role in ("f", "h", "process_noise", "measurement_noise"):
            if not callable(getattr(self, role)):
                raise self.wrong(f"{role} = {getattr(self, role)!r} is not a function")
        if self.kind not in ("ukf", "ekf"):
            raise self.wrong(f"kind = {self.kind!r}; choose ukf or ekf")
        self._check_names("states", self.states)
        for field in ("angles", "scored"):
            unknown = [name for name in getattr(self, field) if name not in self.states]
            if unknown:
                raise self.wrong(
                    f"{field} names {unknown[0]!r}, which is not a state; states are {_listed(self.states)}"
                )
        self._check_parameters()

    def wrong(self, what: str) -> InputError:
        """Return the error of this model."""
        return InputError(f"model {self.name}: {what}")

    def _check_names(self, field: str, names: Sequence[str]) -> None:
        if not names:
            raise self.wrong(f"{field} is empty; name at least one")
        for i, name in enumerate(names):
            if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
                raise self.wrong(
                    f"{field}: {name!r} is not a name; use letters, digits and _, a letter first"
                )
            if name in names[:i]:
                raise self.wrong(f"{field}: {name!r} is there twice")

    def _check_parameters(self) -> None:
        self._check_names("parameters", [t.name for t in self.parameters])
        for t in self.parameters:
            if t.name in SCALING_NAMES:
                raise self.wrong(
                    f"parameters: {t.name!r} is a parameter of the sigma points; choose another name"
                )
            if not (np.isfinite([t.lowest, t.highest]).all() and t.lowest < t.highest):
                raise self.wrong(
                    f"parameter {t.name}: bounds {t.lowest:g}, {t.highest:g}; give a lower and an upper bound"
                )
            if t.logarithmic and t.lowest <= 0:
                raise self.wrong(
                    f"parameter {t.name}: can't be searched in log10 down to {t.lowest:g}; "
                    "give a positive bound, or logarithmic=False"
                )

    @cached_property
    def record(self) -> Any:
        """The class of p: a named tuple, which NumPy code and Numba both accept."""
        return namedtuple("p", [t.name for t in self.parameters])  # pyright: ignore[reportUntypedNamedTuple]

    def values(self, parameters: Mapping[str, Any]) -> Any:
        """p of parameters by name.

        Raises
        ------
        InputError
            If one is missing, unknown or not finite.
        """
        known = [t.name for t in self.parameters]
        needed = [*SCALING_NAMES, *known] if self.kind == "ukf" else known
        missing = [name for name in needed if name not in parameters]
        if missing:
            raise self.wrong(f"parameter {missing[0]!r} is missing; it has {_listed(needed)}")
        unknown = [name for name in parameters if name not in needed]
        if unknown:
            raise self.wrong(f"there is no parameter {unknown[0]!r}; it has {_listed(needed)}")
        for name in needed:
            value = parameters[name]
            if not isinstance(value, Real) or not math.isfinite(value):
                raise self.wrong(f"parameter {name} = {value!r} is not a finite number")
        return self.record(*(float(parameters[name]) for name in known))

    def places(self, names: Sequence[str]) -> list[int]:
        """Indices of states in the state vector."""
        return [self.states.index(name) for name in names]

    def identity(self) -> dict[str, Any]:
        """Identity of this model in plain types: names, bounds, and a hash of the functions."""
        plain: dict[str, Any] = {
            "name": self.name,
            "kind": self.kind,
            "states": list(self.states),
            "angles": list(self.angles),
            "measured_angles": list(self.measured_angles),
            "scored": list(self.scored),
            "parameters": [dict(vars(t)) for t in self.parameters],
        }
        functions = (self.f, self.h, self.process_noise, self.measurement_noise)
        return plain | {"sha256": fingerprint(repr(plain), *functions)}


def as_covariance(noise: Any) -> Array:
    """Q or R, (n, n), from a matrix or its diagonal."""
    noise = np.asarray(noise, dtype=np.float64)
    return np.diag(noise) if noise.ndim == 1 else noise


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
