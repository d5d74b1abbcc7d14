"""`sigmaswarm convert`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def convert(
    *drives: Annotated[str, Parameter(name="DRIVE... OUT")],
    to: Literal["parquet", "csv"] = "parquet",
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Write drives in another form: Parquet is smaller and far quicker to read, CSV is what people and others read.

    Both hold the same bits, and every command takes either. What sigmaswarm does not know, columns of other names, is
    left behind, and said.

    Examples:

        sigmaswarm convert drives/monday drives/tuesday --to parquet compact
        sigmaswarm convert drives compact --to parquet
        sigmaswarm convert compact/monday --to csv drives

    Parameters
    ----------
    drives
        Drive folders or URLs, or folders that hold drive folders; last the folder in which the drives are made.
    to
        parquet or csv.
    json
        Print what was written for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_known, stdout
    from sigmaswarm.drives.reader import all_drive_locations
    from sigmaswarm.drives.table_files import TABLES
    from sigmaswarm.drives.urls import is_url
    from sigmaswarm.errors import InputError

    if len(drives) < 2:
        raise InputError("convert takes drives and, last, a folder for what they are converted to")
    *given, last = drives
    if is_url(last):
        raise InputError(f"{last}: drives are written to folders; name one")
    out, written = Path(last), dict[str, Path]()
    if any((out / table).exists() for table in TABLES):
        raise InputError(f"{last}: is a drive; name, last, the folder in which the converted drives are made")
    for place in all_drive_locations(given):
        drive = read_known(place)
        if drive.name in written:
            raise InputError(
                f"{place}: a second drive is called {drive.name}; convert it into another folder"
            )
        written[drive.name] = sigmaswarm.write_drive(drive, out / drive.name, form=to)
        if not json:
            stdout().print(f"wrote {out / drive.name}")
    if json:
        print_json({"drives": [str(out / name) for name in written]})
