"""Compile functions with Numba, and cache the machine code between processes if this is safe.

Numba caches pickles, so a user who can write them can run code with the rights of the user who reads them. Therefore
only the owner of the cache's folder may write to it. If the folder is not writable or a file is damaged, this module
compiles again, whereas Numba would fail.
"""

# Numba has types of its own, which a type checker for Python does not know.
# pyright: basic, reportAttributeAccessIssue=false

import hashlib
import logging
import os
import pickle
import stat
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numba import config, njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from sigmaswarm.errors import SigmaswarmWarning

_log = logging.getLogger(__name__)
P = ParamSpec("P")
T = TypeVar("T")


def call_once(make: Callable[P, T]) -> Callable[P, T]:
    """Cache results like `functools.cache`, but only one thread computes at a time, so no value is computed twice."""
    lock, made = threading.RLock(), cache(make)

    @wraps(make)
    def made_once(*arguments: P.args, **named: P.kwargs) -> T:
        with lock:
            return made(*arguments, **named)  # pyright: ignore[reportArgumentType] (all are hashable)

    return made_once


@dataclass(frozen=True)
class FunctionRecipe:
    """A function that is generated only if its machine code is not cached, since generation takes half a second.

    ``like`` is a placeholder with the name and parameters of the function. ``key`` distinguishes functions with the
    same name.
    """

    like: Callable[..., Any]
    key: str
    make: Callable[[], Callable[..., Any]]


def cached(function: Callable[..., Any] | FunctionRecipe | None = None, **options: Any) -> Any:
    """Compile with `numba.njit`, and cache the machine code if there is a folder that no other user can access."""
    if function is None:
        return lambda function: cached(function, **options)
    if config.DISABLE_JIT:
        return function.make() if isinstance(function, FunctionRecipe) else function
    dispatcher = njit(**options)(function.like if isinstance(function, FunctionRecipe) else function)
    dispatcher._cache = _cache_of(function, dispatcher)
    return dispatcher


def address_of(function: FunctionRecipe, signature: Any, **options: Any) -> Any:
    """Compile a function and return the address of its machine code, valid in this process.

    If compilation is off (NUMBA_DISABLE_JIT), return the function itself.
    """
    if config.DISABLE_JIT:
        return function.make()
    made = CFunc(function.like, (signature.args, signature.return_type), {}, options)
    made._cache = _cache_of(function, made)
    made.compile()
    _CALLED.append(made)
    return made.address


_CALLED: list[CFunc] = []  # functions that must stay in memory, since their addresses are in use


def _cache_of(function: Callable[..., Any] | FunctionRecipe, compiled: Any) -> Any:
    recipe = function if isinstance(function, FunctionRecipe) else None
    folder, trouble = _folder()
    if folder is not None:
        usual, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            kept = _Cache(recipe.like if recipe else function)
            if Path(kept.cache_path).is_relative_to(folder):
                kept.recipe, kept.compiled = recipe, compiled
                return kept
        except (RuntimeError, OSError):
            pass
        finally:
            config.CACHE_DIR = usual
        trouble = f"{folder} can't be written"
    if recipe:
        _write(recipe, compiled)
    return _NoCache(trouble)


def _write(recipe: FunctionRecipe, compiled: Any) -> None:
    """Generate the function of a recipe, and put it in place of its placeholder ``like``."""
    compiled.py_func = compiled._compiler.py_func = recipe.make()


@cache
def _folder() -> tuple[Path | None, str]:
    """Make the cache folder. Return the folder and "", or None and the reason why there is no folder."""
    if config.CACHE_DIR:
        folder = Path(config.CACHE_DIR).absolute() / "sigmaswarm"
    else:
        folder = Path(AppDirs("sigmaswarm", appauthor=False).user_cache_dir)
    if not folder.is_absolute():
        return None, "there is no home folder"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        folder = folder.resolve()
        private = _is_private(folder)
    except OSError:
        return None, f"{folder} can't be created"
    if private:
        return folder, ""
    what = f"other users have access to {folder}, and could put code there"
    return None, f"{what} (set the folder's mode to 700)"


def _is_private(folder: Path) -> bool:
    """Return True if other users can neither access nor replace a folder, or if the system has no user ids."""
    if not hasattr(os, "getuid"):
        return True
    own, above = folder.stat(), folder.parent.stat()
    exchangeable = above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX
    return own.st_uid == os.getuid() and not own.st_mode & 0o077 and not exchangeable


class _Checked(CompileResultCacheImpl):
    """Machine code with a checksum, since a damaged bit would cause a crash or wrong results."""

    def reduce(self, cres: Any) -> Any:
        kept = dumps(super().reduce(cres))
        return hashlib.sha256(kept).digest(), kept

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        digest, kept = payload
        if hashlib.sha256(kept).digest() != digest:
            raise ValueError("the machine code is damaged")
        return super().rebuild(target_context, pickle.loads(kept))


class _Cache(FunctionCache):
    """A cache that compiles a function again if its file is damaged."""

    _impl_class = _Checked
    recipe: FunctionRecipe | None = None
    compiled: Any = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        overload = None
        with suppress(Exception):  # unpickling a damaged file can raise any exception
            overload = super().load_overload(sig, target_context)
        if overload is None:
            _log_once(str(_folder()[0]))
            if self.recipe:
                _write(self.recipe, self.compiled)
        return overload

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        if self.recipe:
            return sig, codegen.magic_tuple(), self.recipe.key
        return super()._index_key(sig, codegen)

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError:  # a full disk
            pass
        except Exception:  # a damaged index
            try:
                self.flush()
                super().save_overload(sig, data)
            except OSError:
                pass


class _NoCache(NullCache):
    """A cache that stores nothing.

    The first attempt to store machine code gives a warning, once per process and reason.
    """

    def __init__(self, trouble: str) -> None:
        self._trouble = trouble

    def save_overload(self, sig: Any, data: Any) -> None:
        _warn_once(self._trouble)


@cache
def _log_once(folder: str) -> None:
    _log.info("compiling filters, once on this machine: about ten seconds (cached in %s)", folder)


@cache
def _warn_once(trouble: str) -> None:
    warnings.warn(
        f"compiled filters are not cached, since {trouble}: each start compiles them again, which takes about ten "
        "seconds; set NUMBA_CACHE_DIR to a writable folder",
        SigmaswarmWarning,
        stacklevel=2,
    )
