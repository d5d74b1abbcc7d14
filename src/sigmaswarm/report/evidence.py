"""What an evaluation leaves in its folder beside scores and figures, so that its page needs nothing but the folder."""

from collections.abc import Sequence
from pathlib import Path

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import described
from sigmaswarm.files import write_json, write_whole
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.report.tracks import compared, save_tracks, tracks_of
from sigmaswarm.scoring.evaluation import Evaluation
from sigmaswarm.scoring.targets import OUTAGE_LENGTH
from sigmaswarm.versions import versions

FROM_THE_TUNING = ("tuning.toml", "convergence.csv")


def save_evidence(
    evaluation: Evaluation,
    tuning: Path,
    drives: Sequence[Drive],
    folder: Path,
    *,
    outage_length: float = OUTAGE_LENGTH,
    outage_seed: int = 0,
) -> list[Path]:
    """Write evaluation.json, tracks.npz and a copy of the tuning into an evaluation's folder; their paths.

    Parameters
    ----------
    evaluation : Evaluation
        Of ``drives``, in their order.
    tuning : Path
        A tuning.toml, or the folder that holds it.
    drives : sequence of Drive
    folder : Path
        Exists.
    outage_length, outage_seed : float, int
        As `evaluate` was asked.
    """
    file = tuning / "tuning.toml" if tuning.is_dir() else tuning
    parameters = FilterParameters.load(file)
    named = list(zip(evaluation.scores, drives, strict=True))
    asked = {
        "outage_length_s": outage_length,
        "outage_seed": outage_seed,
        "versions": versions(),
        "data": [described(drive) | {"name": name} for name, drive in named],
    }
    write_json(folder / "evaluation.json", asked)
    written = [folder / "evaluation.json"]
    tracks = [tracks_of(drive, compared(drive, parameters), name) for name, drive in named]
    written.append(save_tracks(tracks, folder / "tracks.npz"))
    for name, source in zip(FROM_THE_TUNING, (file, file.parent / "convergence.csv"), strict=True):
        copy = folder / name
        if source.is_file() and not (copy.exists() and copy.samefile(source)):
            write_whole(copy, source.read_bytes())
            written.append(copy)
    return written
