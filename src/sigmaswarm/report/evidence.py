"""The folder of an evaluation: its records, its pictures, and the tuning, so that its page needs nothing else."""

from pathlib import Path

from sigmaswarm.files import make_folder, write_whole
from sigmaswarm.report.figures import save_evaluation_figures
from sigmaswarm.scoring.evaluation import Evaluation
from sigmaswarm.tuning.record import FILE, HISTORY_FILE


def save_evaluation(evaluation: Evaluation, folder: Path, tuning: Path | None = None) -> list[Path]:
    """Write all that `sigmaswarm report` and people look at; the paths of all files.

    Parameters
    ----------
    evaluation : Evaluation
    folder : Path
        Made where it is missing.
    tuning : Path, optional
        The tuning.toml that was evaluated, or the folder that holds it; copied.
    """
    make_folder(folder)
    written = [*evaluation.save(folder), *save_evaluation_figures(evaluation, folder)]
    return written if tuning is None else [*written, *copy_tuning(tuning, folder)]


def copy_tuning(tuning: Path, folder: Path) -> list[Path]:
    """Copy a tuning.toml, or that of a folder, and the history beside it; the paths of what was copied."""
    file = tuning / FILE if tuning.is_dir() else tuning
    written: list[Path] = []
    for name, source in ((FILE, file), (HISTORY_FILE, file.parent / HISTORY_FILE)):
        copy = folder / name
        if source.is_file() and not (copy.exists() and copy.samefile(source)):
            write_whole(copy, source.read_bytes())
            written.append(copy)
    return written
