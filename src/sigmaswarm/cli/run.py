"""`sigmaswarm run`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from sigmaswarm.cli.common import print_result, read_silently, require_free, require_tuning
from sigmaswarm.cli.options import FIELDS, AsRecorded, Overwrite
from sigmaswarm.errors import InputError

if TYPE_CHECKING:
    from sigmaswarm import Drive, FilterParameters
    from sigmaswarm.filters.passes import FilterPass
    from sigmaswarm.filters.run import Run
    from sigmaswarm.learned.folder import LearnedNetwork


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of `sigmaswarm run`.

    Attributes
    ----------
    out
        File to write: NAME.csv, .mat, .tum, .kitti, .geojson, .gpx, .kml or .ros2.
    origin
        Latitude and longitude of x = y = 0: LAT,LON in degrees, for maps of a drive without an origin.
    truth
        Also write the drive's truth to this file; the extension selects the format.
    merge
        With --out NAME.ros2: also copy the messages of this ROS 2 bag. --beside is the deprecated name.
    before
        Also write the fixes before the start of the filter to this file: NAME.csv, .geojson, .gpx or .kml.
    smooth
        Write smoothed estimates, which also use later fixes.
    bank
        Use a filter bank: sixteen filters with different parameters. --swarm is the deprecated name of this option.
    json
        Print a summary as JSON.
    """

    out: Path
    origin: str | None = None
    truth: Path | None = None
    merge: Annotated[Path | None, Parameter(alias="--beside")] = None
    before: Path | None = None
    as_recorded: AsRecorded = False
    smooth: bool = False
    bank: Annotated[bool, Parameter(alias="--swarm")] = False
    overwrite: Overwrite = False
    json: bool = False


def run(
    tuning: Annotated[
        Path,
        Parameter(
            name="TUNING",
            help="A tuning.toml or its folder. If the folder contains a network, --smooth and --bank do not use "
            "the network.",
        ),
    ],
    drive: Annotated[Path, Parameter(name="DRIVE", help="A drive folder.")],
    /,
    *,
    options: Annotated[RunOptions, FIELDS],
) -> None:
    """Run a tuned filter over a drive and write its estimates.

    The file extension selects the format: .csv (t, the states and their standard deviations), .mat (MATLAB), .tum and
    .kitti (poses, for evo), .geojson, .gpx and .kml (maps), .ros2 (a folder with a ROS 2 bag and a layout for
    Foxglove). If the filter is neither a bank nor assisted by a network, the bag also contains innovations and NIS.

    A filter that was tuned without preprocessing (--as-recorded) also runs without preprocessing. A diverged filter is
    reset; --smooth smooths the parts before and after a reset separately.

    A filter bank adapts its parameters to changes of sensors or surroundings. --bank also writes NAME.swarm.csv, a log
    of the bank with one row per second, and NAME.swarm.toml, a filter with the bank's mean parameters in
    the last minute of the drive.

    For example:

        sigmaswarm run tuned drives/friday --out estimate.csv
        sigmaswarm run tuned drives/friday --out estimate.tum --truth truth.tum
        sigmaswarm run tuned drives/friday --out estimate.kml --origin 49.011,8.416
        sigmaswarm run tuned drives/friday --out estimate.ros2 --merge friday.mcap
        sigmaswarm run tuned drives/friday --out smoothed.csv --smooth
        sigmaswarm run tuned drives/friday --out estimate.csv --bank
    """
    read, summary, fixes = _run(tuning, drive, options)
    print_result(options.json, summary, *_lines(summary, read, options, fixes))


def _run(tuning: Path, drive: Path, options: RunOptions) -> "tuple[Drive, dict[str, Any], int]":
    from sigmaswarm.exports.trajectory import (
        BAG,
        check_fixes_target,
        check_target,
        time_origin_of,
        true_trajectory,
        write_estimate,
        write_fixes,
        write_pieces,
    )
    from sigmaswarm.filters.filter_run import FilterRun
    from sigmaswarm.filters.run import estimates_of, whole_pass
    from sigmaswarm.learned.folder import load_learned
    from sigmaswarm.tuning.record import TunedFilter

    out, before, truth = options.out, options.before, options.truth
    _check_options(tuning, drive, options)
    learned = None if options.smooth or options.bank else load_learned(tuning)
    place = _place(options.origin) if options.origin else None
    tuned, read = TunedFilter.read(tuning), read_silently(drive)
    if place and read.origin:
        raise InputError(f"{drive}: already has an origin; omit --origin")
    target: dict[str, Any] = {"origin": place or read.origin, "time_origin": time_origin_of(read)}
    true = true_trajectory(read) if truth else None
    banks, replace = _bank_files(out) if options.bank else (), options.overwrite
    require_free(out, truth, before, *banks, overwrite=replace)
    check_target(out, target["origin"], options.merge, replace=replace)
    if truth:
        check_target(truth, target["origin"], replace=replace)
    if before:
        check_fixes_target(before, target["origin"])
    if options.bank:
        _check_bank_files(out, (truth, before, tuning))
    as_recorded = options.as_recorded or tuned.record.as_recorded
    replay = whole_pass(read, as_recorded=as_recorded)
    run = _start(replay, tuned.parameters, options, learned, as_recorded=as_recorded)
    time = replay.timeline.imu_time
    first, last = float(time[0]), float(time[-1])
    innovations = None
    # The bag is sorted by time, so the innovations must be known before the first estimate is written.
    if out.suffix == BAG and not options.bank and learned is None:
        innovations = FilterRun(replay, tuned.parameters, recover=True).finished().innovations
    more: dict[str, Any] = {"merge": options.merge, "innovations": innovations, "name": read.name}
    write_pieces(estimates_of(run), (first, last), out, replace=replace, **more, **target)
    fixes = write_fixes(read, first, before, **target) if before else 0
    if truth and true:
        write_estimate(true, truth, name=f"{read.name}: truth", replace=replace, **target)
    summary: dict[str, Any] = {"out": str(out), "estimates": len(time), "start_s": first, "end_s": last}
    summary["restarts_s"] = [*run.restarts]
    summary |= _save_bank(run, out) if options.bank else {}
    return read, summary, fixes


def _check_options(tuning: Path, drive: Path, options: RunOptions) -> None:
    from sigmaswarm.drives.writer import FILES

    for file in filter(None, (options.out, options.before, options.truth)):
        if file.resolve().parent == drive.resolve() and file.name in FILES:
            raise InputError(f"{file}: is a file of the drive that this command reads; choose another file")
    if options.smooth and options.bank:
        raise InputError(
            "--smooth and --bank can't be combined, since a filter bank can't be smoothed; omit one option"
        )
    command = f"sigmaswarm run TUNING {quote(str(tuning))} --out {quote(str(options.out))}"
    require_tuning(tuning, f"pass the tuning first, as in {command}")


def _start(
    replay: "FilterPass",
    parameters: "FilterParameters",
    options: RunOptions,
    learned: "LearnedNetwork | None",
    *,
    as_recorded: bool,
) -> "Run":
    from sigmaswarm.filters.bank.run import BankRun
    from sigmaswarm.filters.filter_run import FilterRun
    from sigmaswarm.filters.smoothing import SmootherRun

    if options.bank:
        return BankRun(replay, parameters, recover=True, as_recorded=as_recorded)
    if learned is not None:
        return learned.run(replay, parameters, recover=True)
    return (SmootherRun if options.smooth else FilterRun)(replay, parameters, recover=True)


def _lines(summary: Mapping[str, Any], drive: "Drive", options: RunOptions, fixes: int) -> Iterator[str]:
    from sigmaswarm.drives.fingerprint import START_RULE
    from sigmaswarm.exports.foxglove import LAYOUT_FILE

    first, last, out = summary["start_s"], summary["end_s"], options.out
    if restarts := summary["restarts_s"]:
        yield f"the filter diverged and was reset at t = {', '.join(f'{t:.2f}' for t in restarts)} s"
    what = "smoothed estimates" if options.smooth else "estimates"
    yield f"wrote {out}: {summary['estimates']} {what}, t = {first:.2f} to {last:.2f} s"
    if (layout := out / LAYOUT_FILE).exists():
        yield f"Foxglove: import {layout} as a layout"
    if options.bank:
        yield from (f"the filter bank: {sentence}" for sentence in summary["warnings"])
        yield from (f"wrote {summary['swarm']}", f"wrote {summary['settled']}")
    earlier = first - float(drive.imu.time[0])
    if earlier > 5.0:  # s; a start in motion usually needs less
        written = f"wrote {options.before}: {fixes} fixes before the start of the filter"
        yield f"the first {earlier:.1f} s have no estimate, since a filter starts at {START_RULE}"
        yield (
            written if options.before else "--before NAME.csv writes the fixes before the start of the filter"
        )


def _bank_files(out: Path) -> tuple[Path, Path]:
    return out.with_name(f"{out.stem}.swarm.csv"), out.with_name(f"{out.stem}.swarm.toml")


def _check_bank_files(out: Path, others: Sequence[Path | None]) -> None:
    for file in _bank_files(out):
        if file.is_dir() or file.resolve() in [other.resolve() for other in (out, *others) if other]:
            what = "is a folder" if file.is_dir() else "is another input or output of this command"
            raise InputError(f"{file}: {what}, but --bank writes a file with this name; choose another --out")


def _save_bank(run: Any, out: Path) -> dict[str, Any]:
    from sigmaswarm.files import write_atomically

    log, prior = run.log, run.bank.prior
    warnings = [*prior.warnings(log.settled)]
    log_file, filter_file = _bank_files(out)
    write_atomically(log_file, log.to_frame().write_csv())
    prior.parameters(log.settled).save(filter_file)
    return {
        "swarm": str(log_file),
        "settled": str(filter_file),
        "warnings": warnings,
        "said": warnings,  # deprecated key
    }


def _place(text: str) -> tuple[float, float, float]:
    try:
        latitude, longitude, *altitude = (float(part) for part in text.split(","))
        if abs(latitude) <= 90 and abs(longitude) <= 180 and len(altitude) < 2:
            return latitude, longitude, altitude[0] if altitude else 0.0
    except ValueError:
        pass
    raise InputError(
        f"--origin {text!r} is not a position; write latitude (-90 to 90) and longitude (-180 to 180), for example "
        "49.011,8.416"
    )
