"""Hash of functions: equal code with equal numbers gives an equal hash in every process."""

import hashlib
from functools import partial
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


def fingerprint(*things: Any) -> str:
    """Hash values and functions: their bytecode, and the outside values that they use.

    Bytecode, not source: lambdas and notebooks have it, too, and comments do not change it.
    """
    digest = hashlib.sha256()
    seen: set[int] = set()
    for thing in things:
        _add(digest, thing, seen)
    return digest.hexdigest()


def _add(digest: Any, thing: Any, seen: set[int]) -> None:
    thing = getattr(thing, "py_func", thing)  # what Numba has compiled
    digest.update(type(thing).__name__.encode())
    if isinstance(thing, FunctionType):
        if id(thing) in seen:  # it calls itself
            return
        seen.add(id(thing))
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
    else:  # an object: its class's code and what it holds
        call = type(thing).__call__ if callable(thing) else None
        parts = [type(thing).__qualname__, call, getattr(thing, "__dict__", None)]
    for part in parts:
        _add(digest, part, seen)
    digest.update(b";")


def _names(code: CodeType) -> set[str]:
    """Outside names that a function may use, with those of its inner functions."""
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)
