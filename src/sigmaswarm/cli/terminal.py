"""Text and progress bars on terminals, which may be narrow, ASCII-only or closed."""

import logging
import os
import sys
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any

from sigmaswarm.wording import escape_controls

if TYPE_CHECKING:
    from rich.console import Console

    from sigmaswarm.tuning.search import Progress as TuningProgress

# characters of an error or warning; a longer message is shortened, and a command in it would no longer work
MAX_LINE_LENGTH = 2000
MIN_COLUMNS = 20  # characters, smallest width of a terminal in which tables are readable


def prepare() -> None:
    """Let the streams escape characters that they cannot encode. Ignore a value of COLUMNS below `MIN_COLUMNS`."""
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):  # a closed stream is None
            reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns) < MIN_COLUMNS:
        del os.environ["COLUMNS"]


def report_compilation() -> None:
    """Print messages about the compilation of kernels (which delays a first run) if stderr is a terminal."""
    if sys.stderr is not None and sys.stderr.isatty():
        log = logging.getLogger("sigmaswarm.compilation")
        log.setLevel(logging.INFO)
        log.addHandler(_OnStderr())


class _OnStderr(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        # a StreamHandler would keep the stream that was stderr when the handler was made
        print(f"sigmaswarm: {record.getMessage()}", file=sys.stderr)


def console(**options: Any) -> "Console":
    """Return a console for stdout that escapes control characters and does not interpret markup or emoji codes."""
    from rich.console import Console
    from rich.segment import Segment

    class Plain(Console):
        def render(self, *arguments: Any, **named: Any) -> Iterable[Segment]:
            for segment in super().render(*arguments, **named):
                yield segment if segment.control else Segment(escape_controls(segment.text), segment.style)

        def on_broken_pipe(self) -> None:
            raise  # `main` catches it; Rich would exit with code 1

    return Plain(markup=False, emoji=False, highlight=False, **options)


def print_lines(*lines: object, file: IO[str] | None = None) -> None:
    """Print lines and tables to stdout or to a file, without line breaks in long lines."""
    out = console(soft_wrap=True, file=file)
    for line in lines:
        out.print(line)


def one_line(text: object) -> str:
    """Return a message as one line with escaped control characters, shortened to `MAX_LINE_LENGTH`."""
    line = escape_controls(" ".join(str(text).split()))
    half = MAX_LINE_LENGTH // 2
    return line if len(line) <= MAX_LINE_LENGTH else f"{line[:half]} ... {line[-half:]}"


def mute() -> None:
    """Discard further output, since Python prints an error at exit if stdout is closed."""
    if sys.stdout is not None:
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        except (OSError, ValueError):  # a stream without a file descriptor
            sys.stdout = None


@contextmanager
def tuning_progress(title: str) -> "Generator[Callable[[TuningProgress], None]]":
    """Show the progress of a tuning run on stderr, and yield the callback for `tune`."""
    counted = "generations, lowest cost {task.fields[cost]}, remaining"
    with progress_bar(title, counted, "preparing", cost="-") as show:
        yield lambda progress: show(progress.done, progress.total, cost=f"{progress.best_cost:.3f}")


@contextmanager
def progress_bar(
    title: str, counted: str = "", waiting: str = "", **fields: Any
) -> Generator[Callable[..., None]]:
    """Show a bar and the remaining time on stderr. Yield a function that updates the bar with done, total and fields.

    The bar appears at the first update, so that an earlier error prints only one line. Before the first update, a
    terminal shows ``waiting``. If ``counted`` is empty, the bar shows a percentage.
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
