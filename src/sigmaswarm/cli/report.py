"""`sigmaswarm report`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.cli.common import print_result, require_free
from sigmaswarm.cli.options import Json, Overwrite


def report(
    folder: Annotated[Path, Parameter(name="FOLDER")],
    /,
    *,
    out: Path | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write an HTML page about a folder of results.

    The page needs no network and no other file.

    For example:

        sigmaswarm report evaluation
        sigmaswarm report tuned --out tuning.html

    Parameters
    ----------
    folder
        A folder that `sigmaswarm tune`, `evaluate` or `study` wrote.
    out
        File to write, NAME.html; by default page.html in FOLDER. An earlier page.html is replaced without --overwrite.
    """
    from sigmaswarm.reports.read import save_page

    require_free(out, overwrite=overwrite)
    file = save_page(folder, out)
    print_result(json, {"out": str(file)}, f"wrote {file}")
