"""`sigmaswarm convert`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import print_json, read_silently, require_writable
from sigmaswarm.cli.options import Json, Overwrite
from sigmaswarm.cli.terminal import print_lines
from sigmaswarm.errors import InputError


def convert(
    *drives: Annotated[str, Parameter(name="DRIVE... OUT")],
    to: Literal["parquet", "csv"] = "parquet",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Convert drives between Parquet and CSV.

    Every command reads both formats. Parquet files contain the same numbers as CSV files, are smaller, and are much
    faster to read. Columns that sigmaswarm does not use are dropped with a warning.

    For example:

        sigmaswarm convert drives/monday drives/tuesday --to parquet compact
        sigmaswarm convert drives compact --to parquet
        sigmaswarm convert compact/monday --to csv drives

    Parameters
    ----------
    drives
        Drive folders or URLs, or folders of drive folders; the last argument is the folder for the converted drives.
    to
        Format of the converted drives.
    """
    from sigmaswarm.drives.reader import all_drive_locations
    from sigmaswarm.drives.table_files import TABLES
    from sigmaswarm.drives.urls import is_url

    if len(drives) < 2:
        raise InputError("pass the drives and, as the last argument, a folder for the converted drives")
    *given, last = drives
    if is_url(last):
        raise InputError(f"{last}: is a URL; pass a local folder for the converted drives")
    out, written = Path(last), list[str]()
    if any((out / table).exists() for table in TABLES):
        raise InputError(f"{last}: is a drive; pass a folder for the converted drives as the last argument")
    for place in all_drive_locations(given):
        drive = read_silently(place)
        if drive.name in written:
            raise InputError(
                f"{place}: another drive has the same name, {drive.name}; convert this drive to another folder"
            )
        written.append(drive.name)
        require_writable([out / drive.name], given, overwrite=overwrite)
        sigmaswarm.write_drive(drive, out / drive.name, form=to, overwrite=overwrite)
        if not json:
            print_lines(f"wrote {out / drive.name}")
    if json:
        print_json({"drives": [str(out / name) for name in written]})
