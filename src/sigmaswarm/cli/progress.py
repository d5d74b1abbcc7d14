"""Progress bars on stderr."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sigmaswarm.tuning.search import Progress as TuningProgress


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
    """Show a bar and the remaining time on stderr; yield the function that moves it: done, total, fields.

    The bar appears with the first progress, so that an error stays one line. Until then a terminal shows ``waiting``.
    Without ``counted`` the bar shows percent.
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
