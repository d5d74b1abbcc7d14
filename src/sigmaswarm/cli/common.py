"""Functions that several commands use to read drives and print results."""

import json
import warnings
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from sigmaswarm.cli.terminal import print_lines
from sigmaswarm.files import nan_to_none

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm import Drive
    from sigmaswarm.cli.findings import Remedy
    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.drives.reader import Location
    from sigmaswarm.errors import SigmaswarmWarning


def read_silently(place: "Location") -> "Drive":
    """Read a drive; suppress warnings about gaps and unused samples, which `sigmaswarm doctor` reports."""
    from sigmaswarm.drives.reader import read_with_warnings

    drive, warned = read_with_warnings(place)
    _warn_of_reading(warned, gaps=False)
    return drive


def _warn_of_reading(warned: "Iterable[SigmaswarmWarning]", *, gaps: bool) -> None:
    for warning in {str(warning): warning for warning in warned}.values():
        if gaps or not getattr(warning, "code", "").endswith(("-gap", "-outside")):
            warnings.warn(warning, stacklevel=3)


def read_drives(places: "Sequence[Location]") -> "list[Drive]":
    """Read drives with `read_silently`. ``places`` are drive folders, or folders that contain drive folders."""
    from sigmaswarm.drives.reader import all_drive_locations

    return [read_silently(place) for place in all_drive_locations(places)]


def require_writable(folders: "Iterable[Path]", sources: "Sequence[Location]", *, overwrite: bool) -> None:
    """Raise `InputError` if a folder is among ``sources`` or is not empty. ``overwrite`` permits folders of drives."""
    from sigmaswarm.drives.reader import all_drive_locations
    from sigmaswarm.drives.writer import require_replaceable
    from sigmaswarm.errors import InputError
    from sigmaswarm.files import free_path

    read = {Path(place).resolve() for place in all_drive_locations(sources)}
    for folder in folders:
        if overwrite and folder.resolve() in read:
            raise InputError(f"{folder}: is a drive that this command reads; specify another folder")
        other = free_path(folder.parent, folder.name).parent
        remedy = f"add --overwrite, or specify another folder, for example {quote(str(other))}"
        require_replaceable(folder.resolve(), overwrite, remedy)


def require_free(*files: Path | None, overwrite: bool) -> None:
    """Raise `InputError` if a file, or a bag that `sigmaswarm run` wrote, exists and must not be overwritten."""
    from sigmaswarm.errors import InputError
    from sigmaswarm.exports.foxglove import LAYOUT_FILE

    for file in filter(None, files):
        if not overwrite and (file.is_file() or (file / LAYOUT_FILE).is_file()):
            raise InputError(f"{file}: already exists; choose another name, or add --overwrite")


def require_result_folder(
    out: Path,
    sources: "Iterable[Location | None]",
    kind: str,
    mark: str = "",
    *,
    alone: bool = True,
    overwrite: bool = True,
    option: str = "--overwrite",
) -> None:
    """Raise `InputError` if ``out`` is in a drive, or contains a source, or files other than a result of this kind.

    Without ``overwrite``, also raise the error if ``out`` contains a result of this kind. ``option`` is the option that
    permits this. For ``mark`` and ``alone`` see `earlier_result`.
    """
    from sigmaswarm.drives.writer import drive_around
    from sigmaswarm.errors import InputError
    from sigmaswarm.files import earlier_result, free_path

    for source in filter(None, sources):
        if out.resolve() in (Path(source).resolve(), Path(source).resolve().parent):
            raise InputError(f"{out}: contains {source}, which this command reads; choose another --out")
    if around := drive_around(out.resolve()):
        what = "a drive" if around == out.resolve() else f"in the drive {around}"
        raise InputError(f"{out}: is {what}; choose an --out outside of this folder")
    if earlier_result(out, kind, mark, alone=alone) != frozenset() and not overwrite:
        free = f"choose another folder, for example --out {quote(str(free_path(out)))}"
        article = "an" if kind[0] in "aeiou" else "a"
        raise InputError(f"{out}: already contains {article} {kind}; {free}, or add {option}")


def require_tuning(tuning: Path, remedy: str) -> None:
    """Raise `InputError` with ``remedy`` if a drive was passed where the result of `tune` is needed."""
    from sigmaswarm.drives.reader import has_table
    from sigmaswarm.errors import InputError
    from sigmaswarm.tuning.record import FILE

    if has_table(tuning, "imu") and not (tuning / FILE).exists():
        raise InputError(f"{tuning}: is a drive; {remedy}")


def cluster_at(address: str | None) -> "AbstractContextManager[Client | None]":
    """Return a context manager that yields the client of a cluster, or None without an address."""
    from sigmaswarm.datasets.cluster import connected

    return connected(address) if address is not None else nullcontext()


def read_datasets(
    *groups: "Sequence[Location]",
    cluster: "Client | None" = None,
    remedies: "list[Remedy] | None" = None,
    gaps: bool = False,
) -> "list[Dataset]":
    """Read groups of drives in this process or on the workers of a cluster.

    If ``remedies`` is a list, the doctor checks the drives and adds the remedies for serious faults to the list. If
    ``gaps`` is False, warnings about gaps and unused samples are suppressed.
    """
    from sigmaswarm.cli.findings import warn_of_serious
    from sigmaswarm.cli.terminal import progress_bar
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
    _warn_of_reading(warned, gaps=gaps)
    if remedies is not None:
        for drives, group in zip(datasets, locations, strict=True):
            remedies += warn_of_serious(drives, group, ["imu-gap"] if gaps else [])
    return datasets


def parse_numbers(text: str | None, count: int, option: str, example: str) -> tuple[float, ...] | None:
    """Parse ``count`` numbers that are separated by commas. Return None if the option is not given."""
    from sigmaswarm.errors import InputError

    if text is None:
        return None
    try:
        numbers = tuple(float(v) for v in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(
            f"{option} {text!r} is not {count} numbers; separate them by commas, as in {example}"
        )
    return numbers


def print_json(content: Any) -> None:
    """Print JSON, with null instead of NaN and inf."""
    print(json.dumps(nan_to_none(content), indent=2))


def print_result(as_json: bool, content: Any, *lines: object) -> None:
    if as_json:
        print_json(content)
    else:
        print_lines(*lines)
