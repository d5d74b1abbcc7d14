"""Remarks on a tuning: insert the paths of drive.toml files, and warn if a filter should not be used."""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.wording import TO_DO, printable

if TYPE_CHECKING:
    from sigmaswarm.drives.reader import Location
    from sigmaswarm.tuning.record import TuningRecord

_DESCRIPTION = "drive.toml"


def name_files(remark: str, folders: Sequence[Path]) -> str:
    """Replace drive.toml in a remark by its path.

    If the user must edit the drive.toml of a part of a drive, name the file of the whole drive instead.
    """
    from sigmaswarm.drives.description import cut_of
    from sigmaswarm.drives.split import description_of, find_whole
    from sigmaswarm.tuning.receiver import AT_THE_TOP, TUNE_AGAIN

    if not folders or _DESCRIPTION not in remark:
        return remark
    first, others = folders[0], " and of the other drives" * (len(folders) > 1)
    about = description_of(first)
    cut = cut_of(about)
    if AT_THE_TOP not in remark or "drive" not in cut:
        return remark.replace(_DESCRIPTION, quote(str(first / _DESCRIPTION)) + others)
    if whole := find_whole(first):
        _, folder = whole
        file = f"{quote(str(folder / _DESCRIPTION))} (the whole drive)"
        again = f"run sigmaswarm split {quote(str(folder))} --out {quote(str(first.parent))} --overwrite"
    else:
        file = f"{_DESCRIPTION} of the whole drive {cut['drive']}"
        again = f"split{' and repair' if 'repaired' in about else ''} this drive again"
    remark = remark.replace(TUNE_AGAIN, f"{again} and {TUNE_AGAIN}")
    return remark.replace(AT_THE_TOP, AT_THE_TOP.replace(_DESCRIPTION, file + others))


def warn_of_unusable(tuning: Path, record: "TuningRecord") -> bool:
    """Warn and return True if a filter should not be used; the command then does not suggest how to use the filter."""
    for remark in record.unusable:
        warnings.warn(f"{tuning}: {remark.removeprefix(TO_DO)}", SigmaswarmWarning, stacklevel=2)
    return bool(record.unusable)


def local_folders(places: "Sequence[Location]") -> list[Path]:
    from sigmaswarm.drives.reader import drive_folders
    from sigmaswarm.drives.urls import is_url

    if any(map(is_url, places)):
        return []
    return [folder for place in places for folder in drive_folders(Path(place))]


def name_training_files(
    remarks: Iterable[str], names: Sequence[str], evaluated: "Sequence[Location]"
) -> list[str]:
    """Replace drive.toml in remarks by the path of the file of the first training drive.

    ``names`` are the names of the training drives, which are sought in the folders of the evaluated drives. If none is
    found, the name of the first training drive is added.
    """
    from sigmaswarm.drives.split import description_of

    near = dict.fromkeys(folder.parent for folder in local_folders(evaluated))
    folders = [above / name for name in names for above in near if description_of(above / name)]
    if folders or not names:
        return [name_files(remark, folders) for remark in remarks]
    return [remark.replace(_DESCRIPTION, f"{_DESCRIPTION} of {printable(names[0])}") for remark in remarks]
