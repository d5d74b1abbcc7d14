"""`sigmaswarm evaluate`."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from sigmaswarm import Evaluation


def evaluate(
    tuning: Annotated[Path, Parameter(name="TUNING")],
    drives: Annotated[list[str], Parameter(name="DRIVE", consume_multiple=1, negative=())],
    /,
    *,
    against: Path | None = None,
    out: Path | None = None,
    outage_length: float = 5.0,
    outage_seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    as_recorded: Annotated[bool, Parameter(negative=())] = False,
    trust_log: Annotated[bool, Parameter(negative=())] = False,
    smooth: Annotated[bool, Parameter(negative=())] = False,
    swarm: Annotated[bool, Parameter(negative=())] = False,
    cluster: str | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Compare a tuned filter with the same by data sheet, raw GPS, IMU only, and with another one.

    Use drives that the tuning never saw. All methods start at the same moment from the same state. Without
    truth only the drift over outages can be told, against the fixes that were hidden, and whether the filter's
    forecasts miss the fixes by as much as it says.

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
        A tuning.toml, or the folder that holds it; of `sigmaswarm learn` too, whose network is compared then.
    drives
        Drive folders, or folders that hold drive folders; or URLs of such.
    against
        A second tuning to compare with, its folder or its tuning.toml; or a filter of your own, of any model: a file
        with its parameters in a table [filter], as in a tuning.toml.
    out
        Folder for scores.csv, scores.json, figures, and what `sigmaswarm report` makes a page of.
    outage_length
        Seconds without fixes, after which the drift is measured.
    outage_seed
        Places the outages: again and again, as often as the drive has room for.
    as_recorded
        Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis. A filter that
        was tuned so is evaluated so.
    trust_log
        Don't ask the doctor whether something is seriously wrong with the drives.
    smooth
        Also compare the tuned filter in hindsight, each of its estimates with all fixes known, later ones too.
    swarm
        Also compare a swarm of the tuned filter: sixteen side by side, differently tuned, whose mixture drives.
    cluster
        A Dask cluster whose workers read the drives and do the work: tcp://host:8786, a scheduler file, or local:4 for
        so many processes of this machine. The result does not depend on it.
    json
        Print the scores for machines.
    """
    from functools import partial

    import sigmaswarm
    from sigmaswarm.cli.common import (
        cluster_at,
        print_evaluation,
        print_json,
        print_remarks,
        read_datasets,
        stdout,
        tuned_as_recorded,
    )
    from sigmaswarm.errors import InputError
    from sigmaswarm.learned.folder import load_learned, seen_in
    from sigmaswarm.records import load_record
    from sigmaswarm.reports.evaluation import save_evaluation
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
        result = sigmaswarm.evaluate(
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
        written = save_evaluation(result, out, tuning)
    if out and learned is not None:
        written += learned.save(out)
    if json:
        print_json(result.to_dict())
        return
    print_evaluation(result)
    if (tuned := load_record(TuningRecord, file).result) is not None:
        print_remarks(tuned.doubts)
    for path in written:
        stdout().print(f"wrote {path}")
    page = f"sigmaswarm report {out}" if out else "the same with --out evaluation, for pictures and a page"
    stdout().print(f"next: {page}")


def _warn_of_training_drives(evaluation: "Evaluation") -> None:
    """Say which drives the tuning has seen: scores on them flatter it."""
    import warnings

    from sigmaswarm.errors import SigmaswarmWarning

    for name, found in evaluation.drives.items():
        if found.seen:
            message = (
                f"{name}: the filter was tuned on {found.seen.seconds:.0f} of its {found.data['duration_s']:.0f} s "
                f"({', '.join(found.seen.of)}): its scores are not held out"
            )
            warnings.warn(message, SigmaswarmWarning, stacklevel=2)
