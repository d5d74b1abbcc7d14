"""Progress bars on stderr."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

    from sigmaswarm.tuning.search import Progress as TuningProgress


@contextmanager
def tuning_progress(title: str) -> "Generator[Callable[[TuningProgress], None]]":
    """Show the progress of a tuning and the remaining time on stderr; yield the callback for `tune`."""
    counted = "generations, best cost {task.fields[cost]}, remaining"
    with progress_bar(title, counted, "getting ready", cost="-") as show:
        yield lambda progress: show(progress.done, progress.total, cost=f"{progress.best_cost:.3f}")


@contextmanager
def progress_bar(
    title: str, counted: str, waiting: str = "", **fields: Any
) -> Generator[Callable[..., None]]:
    """Show a bar and the remaining time on stderr; yield the function that moves it: done, total, fields.

    ``waiting`` is shown on a terminal until there is progress.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(counted),
        TimeRemainingColumn(),
    )
    with _late_bar(columns, waiting) as bar:
        task = bar.add_task(title, total=None, **fields)

        def show(done: int, total: int, **changed: Any) -> None:
            bar.start()
            bar.update(task, total=total, completed=done, **changed)

        yield show


@contextmanager
def percent_bar(title: str) -> Generator[Callable[[float], None]]:
    """Show a bar and the remaining time on stderr; yield the function that moves it to a share."""
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with _late_bar(columns) as bar:
        task = bar.add_task(title, total=1.0)

        def show(done: float) -> None:
            bar.start()
            bar.update(task, completed=done)

        yield show


@contextmanager
def _late_bar(columns: "Sequence[ProgressColumn]", waiting: str = "") -> "Generator[Progress]":
    """Create a bar that appears with the first progress, so that an error stays one line."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    status = console.status(waiting) if waiting and console.is_terminal else None

    class Late(Progress):
        def start(self) -> None:
            if status:
                status.stop()
            super().start()

    bar = Late(*columns, console=console)
    if status:
        status.start()
    try:
        yield bar
    finally:
        if status:
            status.stop()
        if bar.live.is_started:
            bar.stop()
