"""Reading drives and printing results, for several commands."""

import json
import math
import warnings
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from sigmaswarm.files import finite
from sigmaswarm.wording import TO_DO

if TYPE_CHECKING:
    from distributed import Client
    from rich.console import Console

    from sigmaswarm import Drive, Evaluation
    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.drives.reader import Location
    from sigmaswarm.errors import SigmaswarmWarning


def read_known(place: "Location") -> "Drive":
    """Read a drive that was imported, checked or tuned on before, without warning of its gaps again."""
    from sigmaswarm.drives.reader import read_with_warnings

    drive, warned = read_with_warnings(place)
    warn_of_reading(warned, gaps=False)
    return drive


def warn_of_reading(warned: "Iterable[SigmaswarmWarning]", *, gaps: bool) -> None:
    """Print the warnings of reading a drive, those about gaps only with ``gaps``."""
    for warning in warned:
        if gaps or not getattr(warning, "code", "").endswith("-gap"):
            warnings.warn(warning, stacklevel=3)


def read_drives(places: "Sequence[Location]") -> "list[Drive]":
    """Read drives as `read_known` does; a folder of drive folders stands for all of them."""
    from sigmaswarm.drives.reader import all_drive_locations

    return [read_known(place) for place in all_drive_locations(places)]


@contextmanager
def cluster_at(address: str | None) -> "Generator[Client | None]":
    """Connect to the cluster at an address until the block ends; None without an address."""
    if address is None:
        yield None
        return
    from sigmaswarm.datasets.cluster import connected

    with connected(address) as client:
        yield client


def read_datasets(
    *groups: "Sequence[Location]", cluster: "Client | None" = None, trusted: bool = True, gaps: bool = False
) -> "list[Dataset]":
    """Read groups of drives on a cluster's workers or in this process.

    Drives that are not ``trusted`` are checked for serious faults. ``gaps`` prints warnings about gaps.
    """
    from sigmaswarm.cli.findings import warn_of_serious
    from sigmaswarm.cli.progress import progress_bar
    from sigmaswarm.datasets.cluster import Cluster
    from sigmaswarm.datasets.dataset import LocalDataset
    from sigmaswarm.datasets.remote import remote_datasets
    from sigmaswarm.drives.reader import all_drive_locations, read_with_warnings

    locations = [all_drive_locations(group) for group in groups]
    if cluster is None:
        read = [[read_with_warnings(location) for location in group] for group in locations]
        datasets: list[Dataset] = [LocalDataset([drive for drive, _ in group]) for group in read]
        warned = [warning for group in read for _, more in group for warning in more]
    else:
        with progress_bar("reading", "drives, remaining") as show:
            remote, warned = remote_datasets(Cluster(cluster), locations, progress=show)
        datasets = [*remote]
    warn_of_reading(warned, gaps=gaps)
    if not trusted:
        for drives, group in zip(datasets, locations, strict=True):
            warn_of_serious(drives, group)
    return datasets


def tuned_as_recorded(tuning: Path) -> bool:
    """Read from a tuning if the filter was tuned without preprocessing."""
    import tomllib

    file = tuning / "tuning.toml" if tuning.is_dir() else tuning
    return tomllib.loads(file.read_text()).get("config", {}).get("as_recorded", False) is True


def numbers_of(text: str, count: int, option: str, example: str) -> tuple[float, ...]:
    """Parse an option of ``count`` numbers separated by commas."""
    from sigmaswarm.errors import InputError

    try:
        numbers = tuple(float(v) for v in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"{option} {text!r} is not {count} numbers; write them with commas, as {example}")
    return numbers


def stdout() -> "Console":
    """Return the console for results."""
    from sigmaswarm.cli.terminal import console

    return console(soft_wrap=True)


def print_json(content: Any) -> None:
    """Print for machines; NaN and inf, which JSON does not know, become null."""
    print(json.dumps(finite(content), indent=2))


def print_remarks(remarks: "Iterable[str]", indent: str = "") -> None:
    """Print the remarks on a tuning, one per line; those that ask for action begin with TO DO."""
    for remark in remarks:
        stdout().print(f"{indent}{'' if remark.startswith(TO_DO) else 'note: '}{remark}")


def print_evaluation(
    evaluation: "Evaluation",
) -> None:
    """The comparison as a table: every drive, the mean, and what the tuning improved; why it has gaps."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from sigmaswarm.drives.fingerprint import START_RULE
    from sigmaswarm.scoring.drifts import OWN, UNTUNED
    from sigmaswarm.scoring.measures import HOW_AGAINST, HOW_UNTUNED
    from sigmaswarm.scoring.remarks import how_far, partly_scored, said_of_drives

    console, record = stdout(), evaluation.record
    methods, known = record.told(evaluation.names, evaluation.measures)
    measures, names = {m: evaluation.measures[m] for m in known}, {m: evaluation.names[m] for m in methods}
    # What a terminal of 80 columns holds: no rules between columns, and a drive's name in a row of its own.
    table = Table(
        title=f"On {said_of_drives(evaluation.asked.data)} (lower is better)",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("method", overflow="fold", min_width=12)
    for measure in measures.values():
        table.add_column("\n".join(wrap(measure.heading, 8)), justify="right", overflow="fold")

    def row(name: str, method: str, values: "Iterable[float | None]") -> None:
        table.add_row(name, *map(_number, values), style="bold" if method == "tuned" else None)

    for drive in evaluation.scores:
        table.add_row(Text(drive, "italic"))
        for method, name in names.items():
            failed = " (failed)" if evaluation.scores[drive][method].failed else ""
            row(name + failed, method, (evaluation.value(drive, method, m) for m in measures))
        table.add_section()
    if len(evaluation.scores) > 1:
        table.add_row(Text("mean", "italic"))
        for method, name in names.items():
            row(name, method, (evaluation.mean(method, m) for m in measures))
    console.print(table)
    late = {n: s for n, f in evaluation.drives.items() if (s := f.record.scored_from_s) and s > 5.0}
    if late:
        starts = ", ".join(f"{s:.0f} s into {name}" for name, s in late.items())
        console.print(f"Filters start, and scores with them, {starts}: at {START_RULE}.")
    for said in partly_scored(evaluation.asked.data):
        console.print(f"{said[0].upper()}{said[1:]}.")
    without_truth = [
        name for name, found in evaluation.drives.items() if not found.data.get("has_truth", True)
    ]
    if without_truth:
        console.print(
            f"{', '.join(without_truth)} {'has' if len(without_truth) == 1 else 'have'} no truth.csv: only the drift "
            "over outages, against hidden fixes whose own errors are in it, and the consistency can be told.",
        )
    for said in how_far(record, evaluation.asked.data):
        console.print(f"{said}.")
    for name, found in evaluation.drives.items():
        if found.frozen:
            console.print(
                f"{name}: no filter took {found.frozen} of the fixes for positions: frozen, they repeat an earlier one "
                "though the car may have moved."
            )
    _print_consistency(evaluation, console)
    for over in (OWN, UNTUNED, "raw_gps"):
        improvement = evaluation.improvement(over) if over in evaluation.names else None
        if improvement is not None:
            console.print(
                f"Position RMSE {abs(improvement):.1f}% {'lower' if improvement >= 0 else 'HIGHER'} "
                f"than {evaluation.names[over]}."
            )
    for name, measure in measures.items():
        drift = evaluation.mean("tuned", name)  # None, too, where the filter failed but in no outage
        if drift is not None and (spread := record.drift_said(name)):
            console.print(f"{measure.title} of the tuned filter: {drift:.3g} m over {spread}.")
    console.print(f"{HOW_UNTUNED}.")
    if OWN not in evaluation.names:
        console.print(f"{HOW_AGAINST}.")
    for said in (*evaluation.worse_than_raw, *evaluation.worse_than_untuned, *evaluation.restarted):
        console.print(f"{said[0].upper()}{said[1:]}.")


def _print_consistency(evaluation: "Evaluation", console: "Console") -> None:
    """Whether the tuned filter's covariances say what its errors are: the figures, and what they mean."""
    from rich.table import Table

    from sigmaswarm.scoring.consistency import verdicts

    table = Table(title="Do its forecasts miss the fixes (NIS), its errors the truth (NEES), as it says?")
    table.title_justify = "left"
    table.add_column("drive")
    for title in ("mean NIS\n(2)", "inside 95%\ngate", "mean NEES\n(2)", "correlation to\nthe next fix (0)"):
        table.add_column(title, justify="right")
    for drive, c in evaluation.consistency.items():
        cells = ["-"] * 4
        if c is not None:
            cells = [
                _number(c.mean_nis),
                f"{c.inside_gate:.0%}",
                _number(c.mean_nees),
                f"{c.autocorrelation[0]:+.2f}",
            ]
        table.add_row(drive, *cells)
    console.print(table)
    for said in verdicts([c and c.summary for c in evaluation.consistency.values()]).values():
        console.print(f"{said[0].upper()}{said[1:]}.")


def _number(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"
