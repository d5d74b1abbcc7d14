"""`sigmaswarm demo`."""

from pathlib import Path

from sigmaswarm.cli.options import Json, Seed
from sigmaswarm.cli.study import StudyOptions, study


def demo(*, out: Path = Path("demo"), seed: Seed = 0, json: Json = False) -> None:
    """Run a small version of the paper's experiment, in about two minutes.

    Example:

        sigmaswarm demo --out demo

    Parameters
    ----------
    out
        Folder for results, tables, figures and the page. An unfinished demo is continued; a finished demo is shown
        again.
    seed
        Seed of the simulated drives, the splits and the searches.
    """
    study(out=out, options=StudyOptions(quick=True, resume=True, json=json), seed=seed)
