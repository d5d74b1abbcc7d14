"""What several commands share: reading drives, tables, progress, JSON."""

import json
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sigmaswarm.files import finite
from sigmaswarm.wording import TO_DO

if TYPE_CHECKING:
    from distributed import Client
    from rich.console import Console
    from rich.progress import Progress, ProgressColumn

    from sigmaswarm import Drive, Evaluation
    from sigmaswarm.drives.places import Place
    from sigmaswarm.errors import SigmaswarmWarning
    from sigmaswarm.fleets.held import Held
    from sigmaswarm.tuning.search import Progress as TuningProgress


def read_known(place: "Place") -> "Drive":
    """Read a drive that was imported, checked or tuned on before: its gaps have been told, and are not told again."""
    from sigmaswarm.drives.places import read_place

    drive, warned = read_place(place)
    warn_of_reading(warned, gaps=False)
    return drive


def warn_of_reading(warned: "Iterable[SigmaswarmWarning]", *, gaps: bool) -> None:
    """Tell what was found while a drive was read; ``gaps``: those, too."""
    for warning in warned:
        if gaps or not getattr(warning, "code", "").endswith("-gap"):
            warnings.warn(warning, stacklevel=3)


def read_drives(places: "Sequence[Place]") -> "list[Drive]":
    """Read drives that are known; a folder of drive folders stands for all of them."""
    from sigmaswarm.drives.places import listed_places

    return [read_known(place) for place in listed_places(places)]


@contextmanager
def cluster_at(address: str | None) -> "Generator[Client | None]":
    """A client of the cluster at an address, until the block ends; None where none is named."""
    if address is None:
        yield None
        return
    from sigmaswarm.fleets.connection import connected

    with connected(address) as client:
        yield client


def held_drives(
    *groups: "Sequence[Place]", cluster: "Client | None" = None, trusted: bool = True, gaps: bool = False
) -> "list[Held]":
    """Groups of drives, read where they are held: by a cluster's workers, or here.

    Those that are not ``trusted`` are shown to the doctor, who says in a line what is serious. ``gaps``: tell them.
    """
    from sigmaswarm.cli.findings import warn_of_serious
    from sigmaswarm.drives.places import listed_places, read_place
    from sigmaswarm.fleets.connection import Cluster
    from sigmaswarm.fleets.fleet import Fleet, fleet_groups
    from sigmaswarm.fleets.held import Here

    listed = [listed_places(places) for places in groups]
    if cluster is None:
        read = [[read_place(place) for place in places] for places in listed]
        held: list[Held] = [Here([drive for drive, _ in group]) for group in read]
        warned = [warning for group in read for _, more in group for warning in more]
    else:
        with progress_bar("reading", "drives, remaining") as show:
            held = [*fleet_groups(Cluster(cluster), listed, progress=show)]
        warned = [warning for fleet in held if isinstance(fleet, Fleet) for warning in fleet.warned]
    warn_of_reading(warned, gaps=gaps)
    if not trusted:
        for drives, places in zip(held, listed, strict=True):
            warn_of_serious(drives, places)
    return held


def tuned_as_recorded(tuning: Path) -> bool:
    """Whether a filter was tuned with frozen fixes absorbed and gaps in the IMU taken for steps like others."""
    import tomllib

    file = tuning / "tuning.toml" if tuning.is_dir() else tuning
    return tomllib.loads(file.read_text()).get("config", {}).get("as_recorded", False) is True


def numbers_of(text: str, count: int, option: str, example: str) -> tuple[float, ...]:
    """So many numbers of an option, written with commas."""
    from sigmaswarm.errors import InputError

    try:
        numbers = tuple(float(v) for v in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"{option} {text!r} is not {count} numbers; write them with commas, as {example}")
    return numbers


def stdout() -> "Console":
    """Where results go."""
    from sigmaswarm.cli.terminal import console

    return console(soft_wrap=True)


def print_json(content: Any) -> None:
    """Print for machines; NaN and inf, which JSON does not know, become null."""
    print(json.dumps(finite(content), indent=2))


@contextmanager
def tuning_progress(title: str) -> "Generator[Callable[[TuningProgress], None]]":
    """Show a tuning's progress, with the time that remains, on stderr; yields tune's callback."""
    counted = "generations, best cost {task.fields[cost]}, remaining"
    with progress_bar(title, counted, "getting ready", cost="-") as show:
        yield lambda progress: show(progress.done, progress.total, cost=f"{progress.best_cost:.3f}")


@contextmanager
def progress_bar(
    title: str, counted: str, waiting: str = "", **fields: Any
) -> Generator[Callable[..., None]]:
    """A bar on stderr, with the time that remains; yields the function that moves it: done, total, fields.

    ``waiting`` says on a terminal what is going on until there is progress.
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
    """A bar on stderr, with the time that remains; yields the function that moves it: the share that is done."""
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
    """A bar that shows nothing before there is progress: a mistake is to be told in one line."""
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


def print_remarks(remarks: "Iterable[str]", indent: str = "") -> None:
    """A tuning's, each in a line: those that ask for action begin with TO DO, the others are notes."""
    for remark in remarks:
        stdout().print(f"{indent}{'' if remark.startswith(TO_DO) else 'note: '}{remark}")


def print_evaluation(evaluation: "Evaluation") -> None:
    """Print the scores of every drive, the mean, the consistency, and the remarks on them."""
    from dataclasses import replace

    from sigmaswarm.scoring.remarks import said_of_drives

    console, view = stdout(), evaluation.view
    scores, mean = view.drive_table(), view.mean_table()
    if len(view.scores.drives) > 1:
        strong = scores.strong | {len(scores.rows) + i for i in mean.strong}
        scores = replace(scores, rows=scores.rows + mean.rows, strong=strong)
    title = f"On {said_of_drives(view.setup.data)} (lower is better)"
    console.print(replace(scores, caption=title).to_rich(grouped=True))
    consistency = replace(
        view.consistency_table(), caption="Consistency of the tuned filter (NIS and NEES: 2)"
    )
    for text in view.coverage():
        console.print(text)
    console.print(consistency.to_rich())
    for text in (
        *view.verdicts().values(),
        view.result(),
        *view.drifts(),
        *view.explanations(),
        *view.warnings(),
    ):
        console.print(text)
