"""`sigmaswarm tune`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from os.path import relpath
from pathlib import Path
from shlex import join, quote
from typing import TYPE_CHECKING, Annotated, Any

import sigmaswarm
from sigmaswarm.cli.common import (
    cluster_at,
    print_json,
    read_datasets,
    require_result_folder,
)
from sigmaswarm.cli.findings import Remedy, velocity_options
from sigmaswarm.cli.options import FIELDS, MORE, Cluster, Json, Places, TrustLog, Verbose, Workers, options_of
from sigmaswarm.cli.output import Output, Remark
from sigmaswarm.cli.remarks import local_folders, name_files, warn_of_unusable
from sigmaswarm.cli.terminal import tuning_progress
from sigmaswarm.errors import InputError
from sigmaswarm.files import DETAILS_FILE, free_path, write_atomically
from sigmaswarm.tuning.config import DEFERRED_OPTIONS, RENAMED, TuneConfig, option_words
from sigmaswarm.wording import TO_DO, as_sentence

if TYPE_CHECKING:
    from sigmaswarm import Drive, Tuning
    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.scoring.tracks import FirstTrack
    from sigmaswarm.tuning.record import TuningRecord

MAX_DIAGNOSED = 3  # drives whose velocity is compared with the positions before a second tuning is proposed
SHORT_HELP = ("objective", "model", "use", "particles", "generations", "trials", "seed")


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """Options of `sigmaswarm tune` that are not fields of its configuration.

    Attributes
    ----------
    validation
        Held-out drives: the search does not use them, and the tuned filter is also evaluated on them.
    start
        Filter from which the search starts: a tuning, or robot_localization's ekf.yaml (then --use selects the inputs).
    paper
        Use the paper's settings: pso, 30 particles, 50 generations, linear scale, gps-rmse, planar5, ukf. Conflicting
        options are refused.
    resume
        Continue an interrupted tuning; the result is the same as without the interruption.
    """

    validation: list[str] | None = None
    start: Path | None = None
    paper: Annotated[bool, MORE] = False
    workers: Annotated[Workers, MORE] = None
    cluster: Annotated[Cluster, MORE] = None
    resume: bool = False
    trust_log: Annotated[TrustLog, MORE] = False
    verbose: Verbose = False
    json: Json = False


@options_of(TuneConfig.model_fields, shown=SHORT_HELP, by_data=DEFERRED_OPTIONS, renamed=RENAMED)
def tune(
    drives: Places, /, *, out: Path, options: Annotated[TuneOptions, FIELDS] = TuneOptions(), **config: Any
) -> None:
    """Tune a filter on drives.

    The filter is written to OUT/tuning.toml. If a drive has no truth, the default objective is the likelihood of the
    fixes. The defaults of --model and --use depend on the sensors of the drives. Keep some drives for `sigmaswarm
    evaluate`.

    For example:

        sigmaswarm tune drives/monday drives/tuesday --out tuned
        sigmaswarm tune drives/training --out tuned --model planar8 --use lateral standstill gate
        sigmaswarm tune drives/training --out tuned --validation drives/monday --trials 5
        sigmaswarm tune drives/training --out tuned --model planar5 --objective innovation-nll
        sigmaswarm tune drives/training --out tuned --start ekf.yaml
        sigmaswarm tune drives/training --out tuned --paper
        sigmaswarm tune drives/training --out tuned --resume
        sigmaswarm tune s3://fleet/training --out tuned --cluster tcp://scheduler:8786

    Values of --objective (usual defaults: truth-pose + 0.2 nees if all drives have truth, otherwise innovation-t; with
    truth and correlated fix errors also 0.1 innovation-t; with tilted12 and white fix errors also forecast-t):

        truth-rmse      position error against truth
        truth-pose      errors of position and heading, and drift in outages
        innovation-nll  likelihood of each fix given its prediction (normal errors)
        innovation-t    like innovation-nll, with Student's t errors (for outliers)
        forecast-t      likelihood of fixes that are hidden for 3 to 5 s
        outage-rmse     prediction error at fixes that are hidden for 3 to 5 s
        nis, nees       penalty for a wrong covariance, as a term of a sum
        gps-rmse        distance of updated estimates to the fixes (paper)

    Values of --use:

        velocity        use the receiver's speed and course
        lateral         assume that the car does not slide sideways
        slip            with lateral: model the sideways slip of the tires
        standstill      assume zero velocity while the car is stationary
        odometer        use the wheel speed
        heading         use the heading from two antennas or a compass
        gate            reject fixes that are far from the prediction
        imu-gate        robot-localization: reject IMU messages with a large NIS
        latency         tune the delay of the fixes
        accuracy        use the standard deviation that the receiver states
        robust          model fix errors by Student's t; replaces gate
        fix-error       estimate the slowly varying error of the fixes

    Parameters
    ----------
    out
        Folder for tuning.toml, convergence history and figures. Without --resume, the folder must not contain a
        tuning.toml.
    """
    again = options.resume or not (out / "tuning.toml").exists()
    require_result_folder(
        out,
        [options.start],
        "tuning",
        "config.json",
        overwrite=again,
        option="--resume (same drives and options) to print it again",
    )
    remedies = None if options.trust_log else list[Remedy]()
    with cluster_at(options.cluster) as client:
        groups = read_datasets(drives, options.validation or [], cluster=client, remedies=remedies, gaps=True)
        tuning, track, following, velocity = _tune(groups, drives, out, options, config)
    from sigmaswarm.reports.tuning import save_tuning_figures  # imported late, since matplotlib takes memory
    from sigmaswarm.tuning.record import FILE

    pictures, record = save_tuning_figures(tuning, track.picture, out), tuning.record
    if options.json:
        print_json(tuning.to_dict())
    output = Output(verbose=options.verbose, silent=options.json)
    _print_tuning(output, tuning, track, drives)
    if not (remedies or record.unusable):
        output.details("the command for a filter with the receiver's velocity", *velocity)
    write_atomically(out / DETAILS_FILE, output.text)
    output.show(f"wrote {', '.join(map(str, (out / FILE, *pictures)))}")
    unusable = warn_of_unusable(out, record)
    if remedies:
        command, repaired = remedies[0]
        then = "tune on the repaired copy" if repaired else "correct the log, and tune again"
        steps = [f"next: {command}", f"      (then {then}, since the faults in the log distort this filter)"]
    elif unusable:
        check = f"sigmaswarm doctor {join(map(str, drives))}"
        steps = [f"next: {check}    (then tune with more --trials, or on other drives)"]
    else:
        first = any(remark.startswith(TO_DO) for remark in tuning.remarks)
        steps = ['first: follow "to do" above, or continue with this filter:'] * first + following
    output.next(*steps, place=out / DETAILS_FILE)


def _tune(
    groups: "Sequence[Dataset]", given: Places, out: Path, options: TuneOptions, config: dict[str, Any]
) -> "tuple[Tuning[Any], FirstTrack, list[str], list[str]]":
    """Tune a filter.

    Return the result, the track on the first drive, the next commands, and lines about a filter with the receiver's
    velocity.
    """
    from concurrent.futures import ThreadPoolExecutor

    from sigmaswarm.scoring.batch import cores
    from sigmaswarm.scoring.tracks import first_track

    read, held_back = groups
    run = {"out": out, "resume": options.resume, "paper": options.paper, "start": options.start}
    with ThreadPoolExecutor(options.workers or cores()) as pool, tuning_progress("tuning") as progress:
        tuning = sigmaswarm.tune(
            read, validation=held_back, executor=pool, progress=progress, **run, **config
        )
    record = tuning.record
    options_of_track = {"as_recorded": record.as_recorded, "shown_std": record.shown_std}
    follow = partial(first_track, parameters=tuning.parameters, **options_of_track)
    (track,) = read.subset([0]).map(follow)
    (part,) = read.subset([0]).map(_is_part)
    alone = len(read) == 1 and not len(held_back)
    evaluate, splitting = (
        _next(out, given[0], tuning.data[0]["name"], part=part) if alone else (_evaluate(out), [])
    )
    against, velocity = _against(out, [one["sha256"] for one in tuning.data]), list[str]()
    if isinstance(tuning.config, TuneConfig) and not options.paper and all(held_back.map(_has_velocity)):
        more = {"start": options.start, "validation": options.validation}
        velocity = _with_velocity(given, tuning.config, read, config | {k: v for k, v in more.items() if v})
    following = [f"next: {evaluate} --out {free_path('evaluation')}{against}", *splitting]
    return tuning, track, following, velocity


def _print_tuning(output: Output, tuning: "Tuning[Any]", track: "FirstTrack", given: Places) -> None:
    from sigmaswarm.scoring.methods import LEGEND
    from sigmaswarm.scoring.remarks import describe_first_track

    record, folders = tuning.record, local_folders(given)
    output.show(
        *([f"model: {tuning.choice} (tune --help explains the names)"] if tuning.choice else []),
        *filter(None, (record.start, record.validation)),
    )
    if record.drifts:
        output.show(record.drifts.to_rich(), LEGEND, "")
    if position := describe_first_track(track):
        output.show(Remark.of(as_sentence(position)))
    output.show(*_larger_drifts(record, _other_part(folders, record)))
    remarks = [name_files(remark, folders) for remark in tuning.remarks if remark not in record.unusable]
    output.show(*(Remark.of(remark) for remark in remarks if remark.startswith(TO_DO)))
    output.details("note", *(Remark.of(remark, "note") for remark in remarks if not remark.startswith(TO_DO)))
    output.details("the cost", *filter(None, (record.training, record.racing)))


def _larger_drifts(record: "TuningRecord", proposed: tuple[str, float] | None = None) -> Iterator[Remark]:
    """Yield a warning for each method that drifts less than the tuned filter.

    ``proposed`` contains name and duration (s) of the drive in the proposed evaluation.
    """
    from sigmaswarm.scoring.targets import OUTAGE_FIRST_AFTER

    config, usual = record.config, TuneConfig.model_fields
    all_evaluations = usual["particles"].default * usual["generations"].default
    few = config["particles"] * config["generations"] < all_evaluations
    length = OUTAGE_FIRST_AFTER + max((one.length_s for one in record.forecasts), default=0.0)
    enough = f"{length:g} s after the filter's start"
    if proposed and proposed[1] < length:
        enough += f" ({proposed[0]} has only {proposed[1]:.0f} s)"
    remedy = (
        "tune with the default --particles and --generations"
        if few
        else f"evaluate the filter on a drive with at least {enough}; if its drift is also larger there, tune on more "
        "or longer drives"
    )
    yield from (Remark("warning", as_sentence(text), remedy=remedy) for text in record.larger_drifts)


def _other_part(folders: Sequence[Path], record: "TuningRecord") -> tuple[str, float] | None:
    """If the filter was tuned on one part of a drive, return name and duration (s) of the other part."""
    from sigmaswarm.drives.description import cut_of
    from sigmaswarm.drives.split import description_of, name_of_other

    if len(folders) != 1:
        return None
    name = name_of_other(record.data[0].name)
    cut = cut_of(description_of(folders[0].parent / name))
    return (name, float(cut["end_s"] - cut["start_s"])) if {"start_s", "end_s"} <= cut.keys() else None


def _is_part(drive: "Drive") -> bool:
    from sigmaswarm.drives.description import CUT

    return CUT in drive.metadata


def _has_velocity(drive: "Drive") -> bool:
    return drive.gps.speed is not None and drive.gps.course is not None


def _velocity_agrees(drive: "Drive") -> bool:
    return bool(velocity_options(sigmaswarm.diagnose(drive)))


def _with_velocity(
    given: Places, config: TuneConfig, read: "Dataset", stated: Mapping[str, Any]
) -> list[str]:
    """Suggest a second tuning with the receiver's velocity, which the first tuning did not use.

    Model and logs must permit the velocity. ``stated`` contains the user's options for the first tuning. The second
    tuning has the same options.
    """
    from sigmaswarm.filters.models import MODELS  # imports NumPy, which would slow down the help

    model = MODELS.get(config.model)
    allowed = model and "velocity" in (model.options or ("velocity",)) and "velocity" not in config.use
    if not allowed or not all(read.map(_has_velocity)):
        return []
    if not all(
        read.subset(range(min(len(read), MAX_DIAGNOSED))).map(_velocity_agrees)
    ):  # a diagnosis takes time
        return []
    words = ["--use", *config.use, "velocity"]
    for name, value in stated.items():
        words += option_words(name, value) if name != "use" else []
    return [
        f"sigmaswarm tune {join(given)} --out {free_path('tuned-velocity')} {join(words)}",
        "      (the logs have the receiver's velocity, which this filter does not use and which may reduce the errors; "
        "compare both filters with evaluate --against)",
    ]


def _against(out: Path, tuned_on: Sequence[str]) -> str:
    """Return the option that adds the newest tuning of the same drives in a sibling folder to an evaluation."""
    from sigmaswarm.scoring.records import SCORES_FILE
    from sigmaswarm.tuning.record import FILE, TuningRecord

    files = out.resolve().parent.glob(f"*/{FILE}")  # an evaluation contains a copy of the tuning
    others = [f for f in files if not f.parent.samefile(out) and not (f.parent / SCORES_FILE).exists()]
    for file in sorted(others, key=lambda file: file.stat().st_mtime, reverse=True)[:20]:
        try:
            data = TuningRecord.read(file).data
        except InputError:
            continue
        if [one.sha256 for one in data] == [*tuned_on]:
            sibling = out.parent / file.parent.name  # as the user writes it, unless OUT is "." or a link
            there = sibling.exists() and sibling.samefile(file.parent)
            other = quote(str(sibling if there else relpath(file.parent)))
            return f" --against {other}"
    return ""


def _evaluate(out: Path, drive: Path | None = None) -> str:
    on = quote(str(drive)) if drive else "HELD_OUT_DRIVE..."
    return f"sigmaswarm evaluate {quote(str(out))} {on}"


def _next(out: Path, given: str, name: str, *, part: bool) -> tuple[str, list[str]]:
    """Return the command that evaluates a filter tuned on one drive.

    For a whole drive, also return lines that state how to split this drive. ``given`` is the path of the drive and
    ``name`` is its name. ``part`` is True for a part of a split drive.
    """
    from sigmaswarm.drives.reader import drive_folders
    from sigmaswarm.drives.split import name_of_other
    from sigmaswarm.drives.urls import is_url

    if is_url(given):
        return _evaluate(out), []
    (folder, *_) = drive_folders(Path(given))  # the path may be the parent folder
    if part:
        rest = folder.parent / name_of_other(name)
        return _evaluate(out, rest if rest.is_dir() else None), []
    parts = free_path("parts")
    train, test = (quote(str(parts / f"{name}-{part}")) for part in ("train", "test"))
    return _evaluate(out), [
        f"or, without other drives: sigmaswarm split {quote(str(folder))} --out {parts}",
        f"      then tune on {train}, and evaluate on {test}",
    ]
