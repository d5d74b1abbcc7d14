"""`sigmaswarm plot`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.cli.common import print_result, read_silently, require_free
from sigmaswarm.cli.options import Json, Overwrite


def plot(
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    out: Path | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Plot the path, speed, IMU, fixes and outages of a drive.

    The plot of a simulated drive also shows the target speed.

    For example:

        sigmaswarm plot drives/friday
        sigmaswarm plot drives/brake-rain-00 --out brake.png

    Parameters
    ----------
    drive
        A drive folder.
    out
        File to write, NAME.png; by default NAME is the name of the drive.
    """
    from sigmaswarm.reports.drive import drive_figure
    from sigmaswarm.reports.figures import check_file, save

    if out is not None:
        check_file(out)
    read = read_silently(drive)
    picture = out or Path(f"{read.name.replace('/', '-')}.png")
    check_file(picture)
    require_free(picture, overwrite=overwrite)
    save(drive_figure(read), picture)
    print_result(json, {"out": str(picture)}, f"wrote {picture}")
