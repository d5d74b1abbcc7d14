"""`sigmaswarm report`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.cli.options import Json


def report(
    folder: Annotated[Path, Parameter(name="FOLDER")],
    /,
    *,
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Write an HTML page on a folder of results.

    The page needs no network and no other file. The folder is one of `sigmaswarm tune`, `sigmaswarm evaluate` or
    `sigmaswarm study`.

    Examples:

        sigmaswarm report evaluation
        sigmaswarm report tuned --out tuning.html

    Parameters
    ----------
    folder
        A folder of results.
    out
        NAME.html; by default page.html in that folder.
    """
    from sigmaswarm.cli.common import print_json, stdout

    file = save_page(folder, out)
    if json:
        print_json({"out": str(file)})
    else:
        stdout().print(f"wrote {file}")


def save_page(folder: Path, out: Path | None = None) -> Path:
    """Write the page of a folder of results, by default into it; return the file."""
    from sigmaswarm.files import write_whole
    from sigmaswarm.reports.draw.html import page
    from sigmaswarm.reports.pages.folders import read_report
    from sigmaswarm.reports.style import check_file

    if out is not None:
        check_file(out, ".html")
    read = read_report(folder)
    file = out or folder / "page.html"
    check_file(file, ".html")
    write_whole(file, page(read))
    return file
