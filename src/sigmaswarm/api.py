"""Public functions that combine several parts of the package."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.checks import unshared_times
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.tuning.record import TunedFilter, TuningRecord, history_of
from sigmaswarm.tuning.result import Tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sigmaswarm.exports.names import Target
    from sigmaswarm.importing.inspection import Inspection
    from sigmaswarm.scoring.evaluation import Evaluation

# Parameters of a filter, a tuning, or the file or folder of a tuning.
Filter = FilterParameters | Tuning[Any] | str | Path


def tuned_filter(given: Filter) -> TunedFilter:
    if isinstance(given, str | Path):
        return TunedFilter.read(Path(given))
    parameters: Any = given.parameters if isinstance(given, Tuning) else given
    if not isinstance(parameters, FilterParameters):
        raise InputError(f"got {type(parameters).__name__}; pass FilterParameters, a Tuning or its path")
    if isinstance(given, Tuning):
        return TunedFilter(parameters, given.record, [*given.seen])
    return TunedFilter(parameters)


def import_log(
    log: str | Path, *, name: str | None = None, say: Callable[[str], Any] | None = None, **settings: Any
) -> Drive:
    """Make a drive from a log, as `sigmaswarm import` does.

    Parameters
    ----------
    log : str or Path
        File or folder that contains the samples of the IMU.
    name : str, optional
        Name of the drive; by default the name of the log.
    say : callable, optional
        Called with each note; by default, notes become warnings.
    **settings
        ``gps``, ``truth`` and ``odometer`` are logs of these data, if ``log`` does not contain them. Other settings are
        ``format``, ``maps`` ({"ax": "acc_x*g"}), ``tables`` ({"imu": "/imu/data"}), ``time``, ``recipe`` (a file) and
        settings of a recipe, such as ``mount``, ``gps_offset_s``, ``origin``, ``gps_lever_arm_m``.

    Returns
    -------
    Drive
        The drive in memory. `write_drive` writes its folder.

    Raises
    ------
    InputError
        If the log can't be read.

    Warns
    -----
    SigmaswarmWarning
        For each note, for example about an assumption, or about times that only the IMU or only the fixes cover, if
        ``say`` is not given.
    """
    from sigmaswarm.importing.convert import import_drive
    from sigmaswarm.importing.opening import request_of

    request = request_of(log, settings)
    imported = import_drive(request, name or Path(log).resolve().stem)
    drive, notes = imported.drive, [*imported.notes, *imported.assumed]
    # The command `sigmaswarm import` reports unshared times as a finding of the doctor.
    if unshared := unshared_times(drive.imu.time, drive.gps.time):
        notes.append(str(unshared).replace(".csv", ""))
    for note in notes:
        say(note) if say else warnings.warn(SigmaswarmWarning(f"{log}: {note}"), stacklevel=2)
    return drive


def inspect_log(log: str | Path, **settings: Any) -> "Inspection":
    """Return the tables of a log, the recipe that `import_log` would use, and notes on assumptions and faults.

    Parameters
    ----------
    log, **settings
        See `import_log`.
    """
    from sigmaswarm.importing.inspection import inspect_request
    from sigmaswarm.importing.opening import request_of

    return inspect_request(request_of(log, settings))


def run(
    drive: Drive | PreparedDrive,
    parameters: Filter,
    *,
    smooth: bool = False,
    bank: bool = False,
    initial: InitialState | None = None,
    recover: bool = True,
    as_recorded: bool | None = None,
) -> Estimate:
    """Run a filter over a drive, without using the truth of the drive.

    Parameters
    ----------
    drive : Drive
    parameters : FilterParameters, Tuning, or the path of a tuning
    smooth : bool
        Smooth the estimates, so that each estimate uses earlier and later fixes.
    bank : bool
        Run a bank of sixteen filters with different parameters; the estimate is their mixture.
    initial : InitialState, optional
        Initial state of the filter; by default the state at the first time at which the drive determines position,
        speed and heading.
    recover : bool
        Reset the filter if it diverges.
    as_recorded : bool, optional
        Run without preprocessing: use stale fixes, and treat gaps in the IMU as ordinary steps. The default is the
        setting of the tuning.

    Returns
    -------
    Estimate
        Times (n,), means (n, n_states) and covariances (n, n_states, n_states) at the IMU samples from the start of the
        filter on.

    Raises
    ------
    AlignmentError
        If no filter can start on the drive, for example because the vehicle is too slow.
    InputError
        If ``smooth`` and ``bank`` are both given.
    """
    from sigmaswarm.filters.bank.run import run_bank
    from sigmaswarm.filters.smoothing import smooth as run_smoother

    tuned = tuned_filter(parameters)
    as_recorded = tuned.record.as_recorded if as_recorded is None else as_recorded
    if smooth and bank:
        raise InputError(
            "smooth and bank can't be combined, since a filter bank is not smoothed; omit one option"
        )
    run_with = run_smoother if smooth else run_bank if bank else run_filter
    return run_with(drive, tuned.parameters, initial=initial, recover=recover, as_recorded=as_recorded)


def evaluate(
    drives: Sequence[Drive] | Drive, parameters: Filter, *, against: Filter | None = None, **options: Any
) -> "Evaluation":
    """Compare a filter with the baseline and a filter without an IMU; with truth, also with raw GPS and dead reckoning.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        Drives that the tuning did not use. If they have no truth, the scores are the consistency of the innovations and
        the drift in simulated outages, measured at the hidden fixes.
    parameters : FilterParameters, Tuning, or the path of a tuning
        A tuning also identifies its training drives, so that the evaluation can warn if ``drives`` contains parts of
        training drives.
    against : FilterParameters, Tuning, or the path of a tuning, optional
        A second filter of any model, or the path of an ekf.yaml of robot_localization.
    **options
        ``outage_length`` (s), ``outage_seed``, ``as_recorded``, ``smooth``, ``bank`` (also evaluate a filter bank),
        ``fixes_alone`` (noise parameters of the filter that uses only the fixes), ``cluster``. ``seen`` contains
        landmarks (positions and yaw rates) by which copies of the training drives are recognized. ``shown_std`` is the
        standard deviation of the fix errors, computed from the truth of the training drives, m per axis.
        ``as_recorded``, ``seen``, ``fixes_alone`` and ``shown_std`` are by default those of the tuning.

    Returns
    -------
    Evaluation
        Scores by drive and method, for ``print``, ``to_frame()`` and ``save(folder)``.

    Raises
    ------
    InputError
        If there are no drives, or ``parameters`` is not a filter.
    AlignmentError
        If no filter can start on a drive, for example because the vehicle is too slow.
    """
    from sigmaswarm.scoring import evaluation

    if isinstance(drives, FilterParameters | Tuning):
        raise InputError("evaluate takes the drives first: evaluate(drives, parameters)")
    tuned = tuned_filter(parameters)
    other = tuned_filter(against).parameters if isinstance(against, Tuning) else against
    own: dict[str, Any] = {"as_recorded": tuned.record.as_recorded, "fixes_alone": tuned.record.fixes_alone}
    own["shown_std"] = tuned.record.shown_std
    own["seen"] = tuned.seen or None
    return evaluation.evaluate(drives, tuned.parameters, against=other, **own | options)


def export(
    parameters: Filter, to: "Target", folder: str | Path | None = None, **options: Any
) -> dict[str, str]:
    """Export a filter to other software: ``c99``, ``filterpy`` or ``robot_localization``.

    Parameters
    ----------
    parameters : FilterParameters, Tuning, or the path of a tuning
    to : str
    folder : str or Path, optional
        Folder for the files; by default nothing is written.
    **options
        For ``replay`` (a Drive), ``as_recorded``, ``lanes`` and ``seed`` see ``sigmaswarm export --help``. ``mounting``
        contains roll, pitch and yaw of the IMU, deg, for an export that rotates raw samples. ``imu_axes`` contains
        expressions with which the import read the IMU's axes. ``as_recorded``, ``mounting`` and ``imu_axes`` are by
        default those of the tuning.

    Returns
    -------
    dict of str to str
        The text of each file by its name.

    Raises
    ------
    InputError
        If the target is unknown or does not support the model.
    """
    from sigmaswarm.exports.names import target_named
    from sigmaswarm.exports.targets import export_texts, write_texts

    tuned, to = tuned_filter(parameters), target_named(to)
    texts = export_texts(tuned.parameters, to, **tuned.record.for_export | options)
    if folder is not None:
        write_texts(texts, folder, to)
    return texts


def report(results: Any, out: str | Path | None = None) -> str:
    """Write results as one HTML page.

    Parameters
    ----------
    results : Evaluation, Tuning, or the folder of an evaluation, a tuning or a study
    out : str or Path, optional
        NAME.html to write; by default nothing is written.

    Returns
    -------
    str
        The page, which needs no network and no other file.

    Raises
    ------
    InputError
        If ``results`` has a type without a page, or a file in the folder is missing or damaged.
    """
    from sigmaswarm.files import write_atomically
    from sigmaswarm.reports.evaluation_page import evaluation_report
    from sigmaswarm.reports.page import page
    from sigmaswarm.reports.read import read_report
    from sigmaswarm.reports.tuning import tuning_report
    from sigmaswarm.scoring.evaluation import Evaluation

    if isinstance(results, str | Path):
        text = page(read_report(Path(results)))
    elif isinstance(results, Evaluation):
        record = TuningRecord.of(results.parameters)
        tracks = [result.tracks for result in results.drives.values() if result.tracks]
        text = page(evaluation_report(results.view, tracks, record))
    elif isinstance(results, Tuning):
        text = page(tuning_report(results.record, history_of(results.trials) if results.trials else None))
    else:
        raise InputError(
            f"an object of type {type(results).__name__} has no page; pass an Evaluation, a Tuning or a folder of "
            "results"
        )
    if out is not None:
        write_atomically(Path(out), text)
    return text


def plot(what: Any, drive: str | None = None) -> "Figure":
    """Draw a drive, an evaluation, a tuning or a comparison of optimizers.

    Parameters
    ----------
    what : Drive, Evaluation, Tuning or Comparison
    drive : str, optional
        For an evaluation, name of the drive whose track is drawn. By default, the scores of all methods are drawn.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If ``what`` can't be drawn, or the evaluation has no track of ``drive``.
    """
    from sigmaswarm.experiments.comparison import Comparison
    from sigmaswarm.reports.compare import comparison_figure
    from sigmaswarm.reports.drive import drive_figure
    from sigmaswarm.reports.evaluation import comparison, track_figure
    from sigmaswarm.reports.tuning import convergence
    from sigmaswarm.scoring.evaluation import Evaluation

    if isinstance(what, Drive):
        return drive_figure(what)
    if isinstance(what, Evaluation):
        return comparison(what) if drive is None else track_figure(what, drive)
    if isinstance(what, Tuning):
        return convergence(what)
    if isinstance(what, Comparison):
        return comparison_figure(what)
    raise InputError(
        f"an object of type {type(what).__name__} has no figure; pass a Drive, an Evaluation, a Tuning or a Comparison"
    )
