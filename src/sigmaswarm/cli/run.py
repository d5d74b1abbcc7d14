"""`sigmaswarm run`."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from sigmaswarm import Estimate


NOT_WORTH_TELLING = 5.0
"""s without an estimate that a drive which begins while driving has anyway."""


def run(
    tuning: Annotated[Path, Parameter(name="TUNING")],
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    out: Path,
    origin: str | None = None,
    truth: Path | None = None,
    beside: Path | None = None,
    before: Path | None = None,
    as_recorded: Annotated[bool, Parameter(negative=())] = False,
    smooth: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Run a tuned filter over a drive and write its estimates.

    The file's ending names the format: .csv (t, x, y, vx, vy, theta and their standard deviations), .mat (MATLAB),
    .tum and .kitti (poses, for evo), .geojson, .gpx and .kml (maps), .ros2 (a ROS 2 bag, which is a folder).

    Examples:

        sigmaswarm run tuned drives/friday --out estimate.csv
        sigmaswarm run tuned drives/friday --out estimate.tum --truth truth.tum
        sigmaswarm run tuned drives/friday --out estimate.kml --origin 49.011,8.416
        sigmaswarm run tuned drives/friday --out estimate.ros2 --beside friday.mcap
        sigmaswarm run tuned drives/friday --out smoothed.csv --smooth

    Parameters
    ----------
    tuning
        A tuning.toml, or the folder that holds it.
    drive
        A drive folder.
    out
        NAME.csv, .mat, .tum, .kitti, .geojson, .gpx, .kml or .ros2.
    origin
        LAT,LON in degrees of x = y = 0, for maps of a drive that does not say it.
    truth
        Also write the drive's truth, in the format that this file's ending names.
    beside
        For --out NAME.ros2: the ROS 2 bag that the drive was imported from; its messages are copied into the new bag
        beside the estimate, byte for byte.
    before
        Also write what is known before the filter's start, the fixes, to NAME.csv, .geojson, .gpx or .kml.
    as_recorded
        Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis. A filter that
        was tuned so is run so.
    smooth
        Estimates in hindsight: each knows all fixes, later ones too. Where the filter started anew smoothing ends, and
        begins again behind it.
    json
        Print a summary for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, read_known, stdout, tuned_as_recorded
    from sigmaswarm.errors import InputError
    from sigmaswarm.export.trajectory import (
        check_fixes_target,
        check_target,
        time_origin_of,
        true_trajectory,
        write_estimate,
        write_fixes,
        write_pieces,
    )
    from sigmaswarm.filters.run import estimates, replay_of
    from sigmaswarm.filters.smoothing import smoothed_estimates

    place = _place(origin) if origin else None
    parameters = sigmaswarm.FilterParameters.load(tuning)
    read = read_known(drive)
    if place and read.origin:
        raise InputError(f"{drive}: says itself where its x = y = 0 is; leave --origin out")
    place = place or read.origin
    true = true_trajectory(read) if truth else None
    check_target(out, place, beside)
    if truth:
        check_target(truth, place)
    if before:
        check_fixes_target(before, place)
    began = time_origin_of(read)
    replay = replay_of(read, as_recorded=as_recorded or tuned_as_recorded(tuning))
    time = replay.timeline.imu_time
    first, last = float(time[0]), float(time[-1])
    restarts: list[float] = []
    pieces = _watched((smoothed_estimates if smooth else estimates)(replay, parameters), restarts)
    write_pieces(pieces, (first, last), out, origin=place, time_origin=began, beside=beside, name=read.name)
    fixes = write_fixes(read, first, before, origin=place, time_origin=began) if before else 0
    if truth and true:
        write_estimate(true, truth, origin=place, time_origin=began, name=f"{read.name}: truth")
    if json:
        ends = {"start_s": first, "end_s": last}
        print_json({"out": str(out), "estimates": len(time), **ends, "restarts_s": restarts})
    else:
        if restarts:
            at = ", ".join(f"{t:.2f}" for t in restarts)
            stdout().print(f"the filter lost its way and started anew at t = {at} s")
        stdout().print(
            f"wrote {len(time)} {'smoothed ' if smooth else ''}estimates from {first:.2f} s to {last:.2f} s to {out}"
        )
        earlier = first - float(read.imu.time[0])
        if earlier > NOT_WORTH_TELLING:
            stdout().print(
                f"the first {earlier:.1f} s have no estimate: a filter starts at the first fix with 4 s and 20 m of "
                "forward driving behind it, which tell it the heading; "
                + (
                    f"wrote the {fixes} fixes before to {before}"
                    if before
                    else "--before NAME.csv writes the fixes"
                )
            )


def _watched(pieces: "Iterator[Estimate]", restarts: list[float]) -> "Iterator[Estimate]":
    """The pieces; when the filter started anew is noted as they pass."""
    for piece in pieces:
        restarts.extend(piece.restarts)
        yield piece


def _place(text: str) -> tuple[float, float, float]:
    """Latitude and longitude (deg), and altitude (m, 0 where it is left out)."""
    from sigmaswarm.errors import InputError

    try:
        latitude, longitude, *altitude = (float(part) for part in text.split(","))
        if abs(latitude) <= 90 and abs(longitude) <= 180 and len(altitude) < 2:
            return latitude, longitude, altitude[0] if altitude else 0.0
    except ValueError:
        pass
    raise InputError(f"--origin {text!r} is not a place; write LAT,LON in degrees, for example 49.011,8.416")
