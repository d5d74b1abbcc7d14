"""`sigmaswarm evaluate`."""

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from sigmaswarm.cli.common import (
    cluster_at,
    print_json,
    read_datasets,
    require_result_folder,
    require_tuning,
)
from sigmaswarm.cli.findings import Remedy
from sigmaswarm.cli.options import FIELDS, AsRecorded, Cluster, Json, Overwrite, Places, Seed, TrustLog
from sigmaswarm.cli.output import Output, Remark
from sigmaswarm.cli.remarks import name_training_files, warn_of_unusable
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.files import DETAILS_FILE, free_path
from sigmaswarm.wording import as_sentence

if TYPE_CHECKING:
    from sigmaswarm import Evaluation
    from sigmaswarm.exports.names import Target
    from sigmaswarm.learned.folder import LearnedNetwork
    from sigmaswarm.tuning.record import TunedFilter, TuningRecord

MAX_SENTENCES = 3  # sentences that are printed without --verbose
WORSE_STEP = (
    "then: tune on more or longer drives, and evaluate again (on these drives, a method without tuning is more "
    "accurate than the tuned filter)"
)
# %; if the outage drift exceeds that of the filter of --against by more, no export is proposed
WORSE_THAN_OTHER = 1.0


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of `sigmaswarm evaluate`.

    Attributes
    ----------
    against
        Another filter to compare with: a tuning, a TOML file with a table [filter], or an ekf.yaml of
        robot_localization.
    out
        Folder for scores.csv, scores.json, figures and the data for `sigmaswarm report`.
    outage_length
        Length of outages, s, in addition to 1 and 30 s. Drift: the error at the end of an outage.
    outage_seed
        Seed of the outage windows.
    smooth
        Also evaluate the smoothed estimates of the tuned filter.
    bank
        Also evaluate a filter bank: the mixture of sixteen filters with different parameters. --swarm is the deprecated
        name.
    verbose
        Also print the scores of each drive, the consistency, all remarks and the names of the written files.
    """

    against: Path | None = None
    out: Path | None = None
    overwrite: Overwrite = False
    outage_length: float = 5.0
    outage_seed: Seed = 0
    as_recorded: AsRecorded = False
    trust_log: TrustLog = False
    smooth: bool = False
    bank: Annotated[bool, Parameter(alias="--swarm")] = False
    cluster: Cluster = None
    verbose: bool = False
    json: Json = False


def evaluate(
    tuning: Annotated[
        Path,
        Parameter(
            name="TUNING",
            help="A tuning.toml, the folder that contains it, or a folder written by `sigmaswarm learn`.",
        ),
    ],
    drives: Places,
    /,
    *,
    options: Annotated[EvaluateOptions, FIELDS] = EvaluateOptions(),
) -> None:
    """Evaluate a tuned filter on drives.

    The filter is compared with the baseline filter (typical parameters, not tuned) and with a filter that uses only the
    fixes. --against adds another filter. If there is truth, the filter is also compared with raw GPS and dead
    reckoning. If there is no truth, the scores are the consistency of the innovations and the drift in simulated
    outages, measured at the hidden fixes. All methods start at the same time from the same state. Use drives that the
    tuning did not use.

    For example:

        sigmaswarm evaluate tuned drives/friday
        sigmaswarm evaluate tuned drives/friday --out evaluation
        sigmaswarm evaluate tuned drives/friday --against tuned-planar8
        sigmaswarm evaluate tuned drives/friday --against mine.toml
        sigmaswarm evaluate tuned drives/friday --against ekf.yaml
        sigmaswarm evaluate tuned drives/friday --smooth --out evaluation
        sigmaswarm evaluate tuned drives/friday --bank
        sigmaswarm evaluate tuned drives/friday --json
    """
    _check_input(tuning, options)  # before the imports, which take seconds
    from sigmaswarm.learned.folder import load_learned
    from sigmaswarm.reports.evaluation import save_evaluation
    from sigmaswarm.tuning.record import TunedFilter

    learned, tuned, out = load_learned(tuning), TunedFilter.read(tuning), options.out
    record = tuned.record
    remedies: list[Remedy] = []
    result = _evaluated(tuning, tuned, drives, options, learned, remedies)
    _warn_of_drives(result, record)
    training_drives = [drive.name for drive in record.data]
    remarks = [one for one in (record.result.warnings if record.result else ()) if one not in record.unusable]
    more = name_training_files(remarks, training_drives, drives)
    details = Output(verbose=True, silent=True)
    unconfirmed = record.unconfirmed_drifts(result.view.outage_lengths())
    print_evaluation(details, result, more, unconfirmed)
    written = (
        save_evaluation(result, out, tuning, learned and learned.save, details=details.text) if out else []
    )
    if options.json:
        print_json(result.to_dict())
        warn_of_unusable(tuning, record)
        return
    output = Output(verbose=options.verbose)
    print_evaluation(output, result, more, unconfirmed)
    if written:
        names = ": " + ", ".join(path.name for path in written) if options.verbose else ""
        output.show(f"wrote {len(written)} files to {out}{names}")
    usable = not warn_of_unusable(tuning, record) and not learned
    export = _better_filter(result, options) or (_export(tuning, tuned, drives) if usable else ())
    output.next(*_next_steps(out, remedies, export), place=out / DETAILS_FILE if out else "")


def print_evaluation(
    output: Output, evaluation: "Evaluation", more: Iterable[str] = (), unconfirmed: Iterable[str] = ()
) -> None:
    """Print the mean scores and the first sentences. The other tables and sentences are details (``--verbose``).

    ``more`` contains additional sentences, for example the warnings of the tuning. ``unconfirmed`` contains drifts that
    exceeded the baseline's on the training drives, and that the evaluation did not measure.
    """
    from sigmaswarm.scoring.methods import LEGEND
    from sigmaswarm.scoring.remarks import describe_drives

    view = evaluation.view
    several = len(view.scores.drives) > 1
    by_drive, sentences = view.drive_table(), view.sentences(map(as_sentence, more))
    title = f"Scores on {describe_drives(view.setup.data)} (lower is better)"
    table = replace(view.mean_table() if several else by_drive, caption=title)
    output.show(
        table.to_rich(grouped=True),
        LEGEND,
        *view.missing_scores(),
        *map(as_sentence, unconfirmed),
        "",
        *map(Remark.of, sentences[:MAX_SENTENCES]),
    )
    if several:
        output.details("the scores by drive", by_drive.to_rich(grouped=True))
    caption = "Consistency of the tuned filter (mean NIS and mean NEES should be 2)"
    tables = replace(view.consistency_table(), caption=caption), view.radius_table()
    output.details("the consistency", *(one.to_rich() for one in tables))
    output.details("remark", *map(Remark.of, sentences[MAX_SENTENCES:]))


def _check_input(tuning: Path, options: EvaluateOptions) -> None:
    from sigmaswarm.filters.robot_yaml import YAML

    if options.out:
        sources, overwrite = [tuning, options.against], options.overwrite
        require_result_folder(options.out, sources, "evaluation", "evaluation.json", overwrite=overwrite)
    if tuning.suffix in YAML:
        raise InputError(
            f"{tuning}: is a configuration of robot_localization, not a tuning; evaluate a tuning and add --against "
            f"{tuning}, or use `sigmaswarm run`"
        )
    require_tuning(tuning, f"pass the tuning first, as in sigmaswarm evaluate TUNING {quote(str(tuning))}")


def _next_steps(out: Path | None, remedies: Sequence[Remedy], export: Iterable[str]) -> Iterator[str]:
    if remedies:
        command, repaired = remedies[0]
        yield f"next: {command}    (then {'use the repaired copy' if repaired else 'correct the log'})"
    elif out:
        yield f"next: sigmaswarm report {quote(str(out))}"
        yield from export
    else:
        yield f"next: to save scores, figures and the data for a report, add --out {free_path('evaluation')}"


def _better_filter(result: "Evaluation", options: EvaluateOptions) -> tuple[str, ...]:
    """Return the next step if another method is more accurate than the filter. Otherwise return ()."""
    from sigmaswarm.scoring.methods import AGAINST
    from sigmaswarm.scoring.remarks import worse_than_raw

    if result.is_worse_than_untuned or worse_than_raw(result.record):
        return (WORSE_STEP,)
    if options.against and (result.improvement(AGAINST, "outage_drift_m") or 0.0) < -WORSE_THAN_OTHER:
        return (f"then: use the filter with the smaller drift, {options.against}, or tune again",)
    return ()


def _export(tuning: Path, tuned: "TunedFilter", drives: Sequence[str]) -> Iterator[str]:
    """Suggest an export to the first target that supports the filter, with a check on the first local drive."""
    from sigmaswarm.drives.urls import is_url
    from sigmaswarm.exports.check import find_compiler
    from sigmaswarm.exports.targets import export_texts

    folders: dict[Target, str] = {"c99": "filter-c", "robot_localization": "filter-ros"}
    for target, folder in folders.items():
        try:
            export_texts(tuned.parameters, target, **tuned.record.for_export)
        except InputError:
            continue
        local = [quote(place) for place in drives if not is_url(place)][:1]
        checkable = local and (target != "c99" or find_compiler())
        check = f" --check {local[0]}" if checkable else ""
        check = f" --replay {local[0]}{check}" if local and target == "c99" else check
        yield f"then: sigmaswarm export {quote(str(tuning))} --to {target} --out {free_path(folder)}{check}"
        return


def _evaluated(
    tuning: Path,
    tuned: "TunedFilter",
    drives: Sequence[str],
    options: EvaluateOptions,
    learned: "LearnedNetwork | None",
    remedies: list[Remedy],
) -> "Evaluation":
    from sigmaswarm.learned.folder import training_landmarks
    from sigmaswarm.scoring.evaluation import evaluate as evaluate_drives

    if not 0 < options.outage_length < inf:
        raise InputError(f"--outage-length must be positive and finite (is {options.outage_length:g})")
    run = learned and partial(learned.run, parameters=tuned.parameters, recover=True)
    with cluster_at(options.cluster) as client:
        (read,) = read_datasets(drives, cluster=client, remedies=None if options.trust_log else remedies)
        return evaluate_drives(
            read,
            tuned.parameters,
            against=options.against,
            outage_length=options.outage_length,
            outage_seed=options.outage_seed,
            as_recorded=options.as_recorded or tuned.record.as_recorded,
            seen=[*tuned.seen, *training_landmarks(tuning)] or None,
            smooth=options.smooth,
            bank=options.bank,
            more={learned.kind: run} if learned and run else {},
            fixes_alone=tuned.record.fixes_alone,
            shown_std=tuned.record.shown_std,
        )


def _warn_of_drives(evaluation: "Evaluation", tuning: "TuningRecord") -> None:
    """Warn about drives that the tuning used, and drives with sensors other than those of the training drives."""
    from sigmaswarm.scoring.remarks import describe_training_drives, other_sensors

    for result in evaluation.drives.values():
        drive = result.record
        if drive.seen_s:
            message = (
                f"{describe_training_drives(drive)}: the errors on training data are smaller than on other data; "
                "evaluate on a drive that the tuning did not use"
            )
            warnings.warn(message, SigmaswarmWarning, stacklevel=2)
    for message in filter(None, (other_sensors(drive, tuning.data) for drive in evaluation.setup.data)):
        warnings.warn(message, SigmaswarmWarning, stacklevel=2)
