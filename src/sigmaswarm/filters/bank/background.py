"""A search in a thread, during which the filters of a bank continue."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

from sigmaswarm.filters.bank.search import SearchResult, search


@cache
def _searcher() -> ThreadPoolExecutor:
    """Return the executor, with one thread, for the searches of all banks in a process."""
    return ThreadPoolExecutor(1, thread_name_prefix="swarm")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_searcher.cache_clear)  # the thread does not exist in a forked process


@dataclass(frozen=True, eq=False)
class PendingSearch:
    """A search over the logged steps before step number ``logged``.

    ``led`` is the filter with the largest weight. The search starts from an earlier state of this filter, or of the
    filter from which it was copied. A forked copy of this object searches in the calling thread, and an unpickled copy
    starts the search again.
    """

    logged: int
    led: int
    arguments: tuple[Any, ...]
    process: int
    found: "Future[SearchResult | None]"

    @classmethod
    def begun(cls, logged: int, led: int, *arguments: Any) -> "PendingSearch":
        return cls(logged, led, arguments, os.getpid(), _searcher().submit(search, *arguments))

    def result(self) -> SearchResult | None:
        return self.found.result() if self.process == os.getpid() else search(*self.arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return PendingSearch.begun, (self.logged, self.led, *self.arguments)
