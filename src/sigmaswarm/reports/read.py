"""HTML page for a folder of results."""

from collections.abc import Callable
from pathlib import Path

from sigmaswarm.errors import InputError
from sigmaswarm.files import add_to_result, write_atomically
from sigmaswarm.reports.evaluation_page import read_evaluation
from sigmaswarm.reports.figures import check_file
from sigmaswarm.reports.page import Report, page
from sigmaswarm.reports.study_page import study_report
from sigmaswarm.reports.tuning import read_tuning, tuning_report

REPORTS: dict[str, Callable[[Path], Report]] = {
    "scores.json": read_evaluation,
    "results.json": study_report,
    "tuning.toml": lambda folder: tuning_report(*read_tuning(folder)),
}


def read_report(folder: Path) -> Report:
    """Read a folder of results. Raises `InputError` if there are no results, or a file is missing or damaged."""
    if not folder.is_dir():
        wrong = "is a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {wrong}; specify a folder that tune, evaluate or study wrote")
    for file, report in REPORTS.items():
        if (folder / file).exists():
            return report(folder)
    if (folder / "config.json").exists() and list(folder.glob("checkpoint-*.npz")):
        raise InputError(
            f"{folder}: the tuning is not finished; add --resume to its command, and run it again"
        )
    raise InputError(
        f"{folder}: contains no results (none of {', '.join(REPORTS)}); specify a folder that "
        "tune, evaluate or study wrote"
    )


def save_page(folder: Path, out: Path | None = None) -> Path:
    """Write the page of a folder of results, by default page.html in this folder. Return the path."""
    if out is not None:
        check_file(out, ".html")
    read, file = read_report(folder), out or folder / "page.html"
    check_file(file, ".html")
    if out is None:
        add_to_result(folder, file.name)
    write_atomically(file, page(read))
    return file
