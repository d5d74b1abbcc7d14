"""`sigmaswarm evaluate`."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from sigmaswarm.cli.options import Cluster, Json, Places, Seed, TrustLog

if TYPE_CHECKING:
    from sigmaswarm import Evaluation


def evaluate(
    tuning: Annotated[Path, Parameter(name="TUNING")],
    drives: Places,
    /,
    *,
    against: Path | None = None,
    out: Path | None = None,
    outage_length: float = 5.0,
    outage_seed: Seed = 0,
    as_recorded: bool = False,
    trust_log: TrustLog = False,
    smooth: bool = False,
    swarm: bool = False,
    cluster: Cluster = None,
    verbose: bool = False,
    json: Json = False,
) -> None:
    """Evaluate a tuned filter on drives.

    It is compared with the baseline, raw GPS, IMU only and, with --against, another filter. Use drives that the tuning
    never saw. All methods start at the same time from the same state. Without truth the scores are the drift over
    outages, against the hidden fixes, and the consistency of the innovations.

    Examples:

        sigmaswarm evaluate tuned drives/friday
        sigmaswarm evaluate tuned drives/friday --out evaluation
        sigmaswarm evaluate tuned drives/friday --against tuned-planar8
        sigmaswarm evaluate tuned drives/friday --against mine.toml
        sigmaswarm evaluate tuned drives/friday --smooth --out evaluation
        sigmaswarm evaluate tuned drives/friday --swarm
        sigmaswarm evaluate tuned drives/friday --json

    Parameters
    ----------
    tuning
        A tuning.toml, or the folder that holds it; also a folder of `sigmaswarm learn`.
    against
        A second tuning to compare with, or a file with your own parameters in a table [filter].
    out
        Folder for scores.csv, scores.json, figures, and what `sigmaswarm report` needs.
    outage_length
        Length of the outages at whose end the drift is measured, s.
    outage_seed
        Seed of the outage windows.
    as_recorded
        Run without preprocessing, for diagnosis: use stale fixes, treat IMU gaps as ordinary steps.
    smooth
        Also evaluate the smoothed estimates of the tuned filter.
    swarm
        Also evaluate a filter bank: sixteen variants of the tuned filter and their mixture.
    verbose
        Also print each drive, the consistency, all remarks and the files.
    """
    from functools import partial

    import sigmaswarm
    from sigmaswarm.cli.common import (
        cluster_at,
        print_evaluation,
        print_json,
        read_datasets,
        stdout,
        tuned_as_recorded,
    )
    from sigmaswarm.errors import InputError
    from sigmaswarm.learned.folder import load_learned, seen_in
    from sigmaswarm.records import load_record
    from sigmaswarm.reports.evaluation import save_evaluation
    from sigmaswarm.scoring.evaluation import evaluate as evaluate_drives
    from sigmaswarm.tuning.record import FILE, TuningRecord, seen_by

    parameters = sigmaswarm.FilterParameters.load(tuning)
    file = tuning / FILE if tuning.is_dir() else tuning
    learned = load_learned(tuning)
    more = (
        {} if learned is None else {learned.kind: partial(learned.run, parameters=parameters, recover=True)}
    )
    own = None if against is None else sigmaswarm.FilterParameters.load(against)
    if not 0 < outage_length < inf:
        raise InputError(f"--outage-length must be positive and finite (is {outage_length:g})")
    with cluster_at(cluster) as client:
        (read,) = read_datasets(drives, cluster=client, trusted=trust_log)
        result = evaluate_drives(
            read,
            parameters,
            against=own,
            outage_length=outage_length,
            outage_seed=outage_seed,
            as_recorded=as_recorded or tuned_as_recorded(tuning),
            seen=[*seen_by(file), *seen_in(tuning)] or None,
            smooth=smooth,
            swarm=swarm,
            more=more,
        )
    _warn_of_training_drives(result)
    written: list[Path] = []
    if out:
        written = save_evaluation(result, out, tuning, learned)
    if json:
        print_json(result.to_dict())
        return
    tuned = load_record(TuningRecord, file).result
    print_evaluation(result, verbose=verbose, more=tuned.warnings if tuned else ())
    if written:
        names = ", ".join(path.name for path in written) if verbose else f"{len(written)} files"
        stdout().print(f"wrote {names} to {out}")
    page = f"sigmaswarm report {out}" if out else "the same with --out evaluation, for pictures and a page"
    stdout().print(f"next: {page}")


def _warn_of_training_drives(evaluation: "Evaluation") -> None:
    """Warn of drives that the tuning has seen: scores on them are too good."""
    import warnings

    from sigmaswarm.errors import SigmaswarmWarning

    for name, found in evaluation.drives.items():
        drive = found.record
        if drive.seen_s:
            message = (
                f"{name}: the filter was tuned on {drive.seen_s:.0f} of its {drive.duration_s:.0f} s "
                f"({', '.join(drive.seen_in)}): its scores are not held out"
            )
            warnings.warn(message, SigmaswarmWarning, stacklevel=2)
