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
    """Make one HTML page of a folder of results: a summary, and the evidence to explore.

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

    file = save_page(folder, out)
    if json:
        print_json({"out": str(file)})
    else:
        stdout().print(f"wrote {file}")


def save_page(folder: Path, out: Path | None = None) -> Path:
    """Make the page of a folder of results, by default in it; the file."""
    from sigmaswarm.files import write_whole
    from sigmaswarm.reports.figures import check_file
    from sigmaswarm.reports.page import page
    from sigmaswarm.reports.pages.folders import read_report

    if out is not None:
        check_file(out, ".html")
    read = read_report(folder)
    file = out or folder / "page.html"
    check_file(file, ".html")
    write_whole(file, page(read))
    return file
