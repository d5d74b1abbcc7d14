"""Processes that were forked: Polars does not work in them once it has worked in their parent.

A fork copies the memory of Polars' thread pool and none of its threads, so a child waits for ever for the first table
that it reads. Children of a parent that had not yet used Polars make a pool of their own.
"""

import os
import re
from pathlib import Path

from sigmaswarm.errors import SigmaswarmError

_THREAD = re.compile(r"polars-\d|async-executor-")
"""The name of a thread of Polars' pools (Linux shows 15 letters of it). Each names itself when it first runs, which on
a busy machine is late: number 1 may have done all the work before number 0 has its name."""


class _State:
    """This process's: whether Polars has worked in it; whether it did in the parent, so that it can't here."""

    used = lost = lost_by_children = False


def require_threads() -> None:
    """To be called before tables are read or written: an error at once is better than to wait for ever."""
    if _State.lost:
        raise SigmaswarmError(
            "tables can't be read or written in a process that was forked after its parent did so (Polars' threads "
            'are not copied); start processes with multiprocessing.get_context("spawn"), or read drives before the fork'
        )
    _State.used = True


def _before() -> None:
    _State.lost_by_children = _State.lost or _State.used or _threads_run()


def _in_child() -> None:
    _State.lost = _State.lost_by_children
    _State.used = False


def _threads_run() -> bool:
    """True if Polars' threads run here, whoever started them; elsewhere than on Linux nobody knows."""
    try:
        names = [(task / "comm").read_text() for task in Path("/proc/self/task").iterdir()]
    except OSError:
        return False
    return any(_THREAD.match(name) for name in names)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_in_child)
