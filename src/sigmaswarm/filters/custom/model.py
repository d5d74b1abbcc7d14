"""Users' models: states, functions, and the parameters that are tuned."""

import hashlib
import keyword
import math
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from numbers import Real
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Literal

import numpy as np
from scipy.special import chdtri

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError, warn_deprecated

SCALING_NAMES = ("alpha", "beta", "kappa")
"""Scaling of the sigma points; the tuning of an unscented filter also searches these parameters."""


@dataclass(frozen=True)
class Tunable:
    """A parameter that is tuned.

    Attributes
    ----------
    name : str
        f, h and the noise functions read the value as ``p.NAME``.
    lowest, highest : float
        Bounds of the search.
    logarithmic : bool
        Search log10 of the parameter. Use this for ranges that span powers of ten, such as those of variances and time
        constants.
    unit : str
        Unit in results.
    """

    name: str
    lowest: float
    highest: float
    logarithmic: bool = True
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Model:
    """A user's process and measurement, and their tuned parameters.

    ``p`` contains the values of ``parameters`` by name, such as ``p.length``. Plain functions of numbers and NumPy
    arrays are compiled with Numba; with other functions, the filter is about a hundred times slower.

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
        Indices of the elements of a measurement that are angles, rad.
    scored : tuple of str
        States whose errors the objective truth-rmse contains; empty: all states with truth in the log.
    robust : float, optional
        Probability, such as 0.99, that defines outliers: measurements whose NIS is above this quantile of chi-square.
        In the update with an outlier, S is multiplied by NIS / quantile (G. Chang, Journal of Geodesy 88, 2014), and
        the objective innovation-nll increases only with the logarithm of its NIS. After three or more consecutive
        outliers over at least 5 s, the state is assumed to be wrong, and further consecutive outliers have full weight.
        If None, all measurements have full weight.
    kind : {"ukf", "ekf"}
        Unscented or extended. The extended filter takes derivatives by complex steps, so f and h must accept complex
        states and are not compiled.

    Raises
    ------
    InputError
        If a name, a bound or a function is not valid.
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
    robust: float | None = None

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
        if self.robust is not None and not (isinstance(self.robust, Real) and 0.5 <= self.robust < 1):
            raise self.wrong(
                f"robust = {self.robust!r} is not a probability of at least 0.5 and below 1; pass for example 0.99"
            )
        self._check_names("states", self.states)
        for field in ("angles", "scored"):
            unknown = [name for name in getattr(self, field) if name not in self.states]
            if unknown:
                raise self.wrong(
                    f"{field} names {unknown[0]!r}, which is not a state; the states are {', '.join(self.states)}"
                )
        self._check_parameters()

    def wrong(self, what: str) -> InputError:
        return InputError(f"model {self.name}: {what}")

    def _check_names(self, field: str, names: Sequence[str]) -> None:
        if not names:
            raise self.wrong(f"{field} is empty; name at least one")
        for i, name in enumerate(names):
            if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
                raise self.wrong(
                    f"{name!r} in {field} is not a valid name; use letters, digits and _, begin with a letter, and "
                    "avoid Python keywords"
                )
            if name in names[:i]:
                raise self.wrong(f"{name!r} occurs twice in {field}; rename one of them")

    def _check_parameters(self) -> None:
        self._check_names("parameters", [t.name for t in self.parameters])
        for t in self.parameters:
            if t.name in SCALING_NAMES:
                raise self.wrong(
                    f"{t.name!r} in parameters is a parameter of the sigma points; choose another name"
                )
            if not (np.isfinite([t.lowest, t.highest]).all() and t.lowest < t.highest):
                raise self.wrong(
                    f"the bounds {t.lowest:g}, {t.highest:g} of {t.name} are not a range; pass two finite numbers, "
                    "the lower bound first"
                )
            if t.logarithmic and t.lowest <= 0:
                raise self.wrong(
                    f"the lower bound {t.lowest:g} of {t.name} has no logarithm; pass a positive bound, or "
                    f"logarithmic=False"
                )

    @cached_property
    def record(self) -> Any:
        """Class of ``p``: a named tuple, which Python and Numba both accept."""
        return _record(tuple(t.name for t in self.parameters))

    def values(self, parameters: Mapping[str, Any]) -> Any:
        """Return ``p`` from parameters by name; raise `InputError` if a parameter is missing, unknown or not finite."""
        known = [t.name for t in self.parameters]
        needed = [*SCALING_NAMES, *known] if self.kind == "ukf" else known
        missing = [name for name in needed if name not in parameters]
        if missing:
            raise self.wrong(f"parameter {missing[0]!r} is missing; the parameters are {', '.join(needed)}")
        unknown = [name for name in parameters if name not in needed]
        if unknown:
            raise self.wrong(f"there is no parameter {unknown[0]!r}; the parameters are {', '.join(needed)}")
        for name in needed:
            value = parameters[name]
            if not isinstance(value, Real) or not math.isfinite(value):
                raise self.wrong(f"parameter {name} = {value!r} is not a finite number")
        return self.record(*(float(parameters[name]) for name in known))

    def limits(self, m: int) -> Array:
        """Return the NIS above which measurements of 1 to m elements are outliers, (m,) (see ``robust``)."""
        outside = 0.0 if self.robust is None else 1.0 - self.robust
        return chdtri(np.arange(1, m + 1), outside)

    def indices(self, names: Sequence[str]) -> list[int]:
        """Return the indices of states by name."""
        return [self.states.index(name) for name in names]

    def places(self, names: Sequence[str]) -> list[int]:
        """Deprecated name of ``indices``."""
        warn_deprecated("Model.places", "Model.indices")
        return self.indices(names)

    def identity(self) -> dict[str, Any]:
        """Return the names and bounds in plain types, and a hash of names, bounds and functions."""
        plain: dict[str, Any] = {
            "name": self.name,
            "kind": self.kind,
            "states": list(self.states),
            "angles": list(self.angles),
            "measured_angles": list(self.measured_angles),
            "scored": list(self.scored),
            "parameters": [dict(vars(t)) for t in self.parameters],
        }
        plain |= {} if self.robust is None else {"robust": float(self.robust)}
        functions = (self.f, self.h, self.process_noise, self.measurement_noise)
        return plain | {"sha256": fingerprint(repr(plain), *functions)}


@cache
def _record(names: tuple[str, ...]) -> Any:
    """Return one class for equal names, since Numba would compile a kernel again for another class."""
    return namedtuple("p", names)  # pyright: ignore[reportUntypedNamedTuple]


def as_covariance(noise: Any) -> Array:
    """Return Q or R, (n, n), from a matrix or its diagonal."""
    noise = np.asarray(noise, dtype=np.float64)
    return np.diag(noise) if noise.ndim == 1 else noise


def fingerprint(*things: Any) -> str:
    """Hash values and functions; a function is hashed by its bytecode and the global values that it uses.

    Equal code with equal values has the same hash in every process, even in lambdas and notebooks.
    """
    digest = hashlib.sha256()
    visited: set[int] = set()
    for thing in things:
        _add(digest, thing, visited)
    return digest.hexdigest()


def _add(digest: Any, thing: Any, visited: set[int]) -> None:
    thing = getattr(thing, "py_func", thing)  # the Python function of a Numba dispatcher
    digest.update(type(thing).__name__.encode())
    if isinstance(thing, FunctionType):
        if id(thing) in visited:  # a recursive function, or one that several functions call
            return
        visited.add(id(thing))
        cells = dict(zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True))
        outside = {name: cell.cell_contents for name, cell in cells.items()}
        outside |= {n: thing.__globals__[n] for n in _names(thing.__code__) if n in thing.__globals__}
        parts: list[Any] = [thing.__code__, thing.__defaults__, thing.__kwdefaults__, outside]
    elif isinstance(thing, CodeType):
        parts = [thing.co_code, *thing.co_consts, *thing.co_names, *thing.co_varnames]
    elif isinstance(thing, partial):
        parts = [thing.func, thing.args, thing.keywords]
    elif isinstance(thing, dict):
        parts = [part for key in sorted(thing, key=repr) for part in (key, thing[key])]
    elif isinstance(thing, tuple | list):
        parts = list(thing)
    elif isinstance(thing, np.ndarray):
        parts = [thing.dtype.str, thing.shape, thing.tobytes()]
    elif isinstance(thing, ModuleType | BuiltinFunctionType | type | np.ufunc):
        parts = [thing.__name__]
    elif isinstance(thing, bool | int | float | complex | str | bytes | np.generic | frozenset | None):
        parts = []
        digest.update(repr(sorted(thing, key=repr) if isinstance(thing, frozenset) else thing).encode())
    else:  # an object: the code of its class, and its attributes
        call = type(thing).__call__ if callable(thing) else None
        parts = [type(thing).__qualname__, call, getattr(thing, "__dict__", None)]
    for part in parts:
        _add(digest, part, visited)
    digest.update(b";")


def _names(code: CodeType) -> set[str]:
    """Return the names of globals that a function and its inner functions may use."""
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)
