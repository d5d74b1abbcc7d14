"""`sigmaswarm report`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def report(
    folder: Annotated[Path, Parameter(name="FOLDER")],
    /,
    *,
    out: Path | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Make one HTML page of a folder of results: a summary, tables, charts and tracks to explore.

    The page needs no network and no other file. The folder is one that `sigmaswarm tune`, `sigmaswarm evaluate` or
    `sigmaswarm study` wrote.

    Examples:

        sigmaswarm report evaluation
        sigmaswarm report tuned --out tuning.html

    Parameters
    ----------
    folder
        A folder of results.
    out
        NAME.html; by default page.html in that folder.
    json
        Print what was written for machines.
    """
    from sigmaswarm.cli.common import print_json, stdout
    from sigmaswarm.reports.pages.folders import save_page

    file = save_page(folder, out)
    if json:
        print_json({"out": str(file)})
    else:
        stdout().print(f"wrote {file}")
