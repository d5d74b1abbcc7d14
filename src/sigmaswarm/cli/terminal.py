"""Print text without control characters on terminals that may be narrow, ASCII-only or closed; show progress bars."""

import logging
import os
import sys
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from sigmaswarm.wording import visible

if TYPE_CHECKING:
    from rich.console import Console

    from sigmaswarm.tuning.search import Progress as TuningProgress

LONGEST_LINE = 600
"""Largest number of characters of an error or warning. Longer messages, for example with long paths, are shortened."""
NARROWEST = 20
"""Smallest number of columns of a table."""


def prepare() -> None:
    """Escape characters that the streams cannot encode, and ignore an invalid width."""
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):  # neither if the stream is closed
            reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns) < NARROWEST:
        del os.environ["COLUMNS"]


def tell_of_compiling() -> None:
    """Show on a terminal that kernels are compiled, when a first run begins to compile."""
    if sys.stderr is not None and sys.stderr.isatty():
        log = logging.getLogger("sigmaswarm.compilation")
        log.setLevel(logging.INFO)
        log.addHandler(_OnStderr())


class _OnStderr(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        print(f"sigmaswarm: {record.getMessage()}", file=sys.stderr)  # wherever that is by then


def console(**options: Any) -> "Console":
    """A console on stdout that shows text as it is: no markup, no emoji, control characters escaped."""
    from rich.console import Console
    from rich.segment import Segment

    class Plain(Console):
        def render(self, *arguments: Any, **named: Any) -> Iterable[Segment]:
            for segment in super().render(*arguments, **named):
                yield segment if segment.control else Segment(visible(segment.text), segment.style)

        def on_broken_pipe(self) -> None:
            raise  # where it is caught by `main`; Rich would exit with 1

    return Plain(markup=False, emoji=False, highlight=False, **options)


def one_line(text: object) -> str:
    """Shorten a message to one readable line."""
    line = visible(" ".join(str(text).split()))
    half = LONGEST_LINE // 2
    return line if len(line) <= LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"


def mute() -> None:
    """Discard the remaining output of a closed stream, which would cause an error message of Python at exit."""
    if sys.stdout is not None:
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        except (OSError, ValueError):  # not a stream of the system's
            sys.stdout = None


@contextmanager
def tuning_progress(title: str) -> "Generator[Callable[[TuningProgress], None]]":
    """Show the progress of a tuning and the remaining time on stderr; yield the callback for `tune`."""
    counted = "generations, best cost {task.fields[cost]}, remaining"
    with progress_bar(title, counted, "getting ready", cost="-") as show:
        yield lambda progress: show(progress.done, progress.total, cost=f"{progress.best_cost:.3f}")


@contextmanager
def progress_bar(
    title: str, counted: str = "", waiting: str = "", **fields: Any
) -> Generator[Callable[..., None]]:
    """Show a bar and the remaining time on stderr; yield a function of done, total and fields that updates the bar.

    The bar appears with the first progress, so that an error before it is one line. Until then a terminal shows
    ``waiting``. Without ``counted`` the bar shows percent.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    status = console.status(waiting) if waiting and console.is_terminal else None
    done_of = (MofNCompleteColumn(), TextColumn(counted)) if counted else (TaskProgressColumn(),)
    columns = (TextColumn("{task.description}"), BarColumn(), *done_of, TimeRemainingColumn())
    bar = Progress(*columns, console=console)
    task = bar.add_task(title, total=None, **fields)

    def show(done: float, total: float, **changed: Any) -> None:
        if status:
            status.stop()
        bar.start()
        bar.update(task, total=total, completed=done, **changed)

    if status:
        status.start()
    try:
        yield show
    finally:
        if status:
            status.stop()
        if bar.live.is_started:
            bar.stop()
