"""Assemble a drive from joined columns, on one clock and in one frame."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.checks import shortage_of
from sigmaswarm.drives.drive import Drive, Gps, Imu, Odometer
from sigmaswarm.drives.mounting import AXES_KEY, with_rotation
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import Origin, wrap_angle
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.joining import Samples, join, without_column
from sigmaswarm.importing.mounting import parse_mount, rotate
from sigmaswarm.importing.positions import (
    MAX_SPEED,
    Say,
    Values,
    add_local_position,
    chord_course,
    coarse_degrees,
    first_place,
    fitting_angle,
    without_wrong_velocity,
)
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.synchronization import Sensors, in_seconds, overlap_remedy, synchronized
from sigmaswarm.importing.truth import SEED, fixes_of_truth, made_truth

REQUIRED: Mapping[Role, tuple[str, ...]] = {"imu": ("ax", "ay", "gz"), "odometer": ("speed",)}
WITHOUT_POSITION = "gps: no column contains a position; map lat and lon (deg), or x and y (m east, north)"


@np.errstate(all="ignore")  # infinite values are refused when the drive is read back
def assemble(
    name: str,
    gathered: Mapping[Role, Sequence[PartColumns]],
    recipe: Recipe,
    say: Say,
    recording: int | None = None,
) -> Drive:
    """Make a drive from gathered columns. ``say`` receives sentences on assumptions and omissions.

    ``recording`` is the number of the recording to use, counted from 1, if a clock restarts within a table.
    """
    joined: Sensors = {
        role: join(parts, role, REQUIRED.get(role, ()), say, recording) for role, parts in gathered.items()
    }
    sensors, seconds, zero = synchronized(joined, recipe, say)
    imu = _imu(seconds["imu"], sensors["imu"].values, recipe)
    origin, truth = recipe.origin, None
    gps: Values = {}
    if "gps" in sensors:
        gps, origin = _checked_fixes(seconds["gps"], sensors["gps"], origin, say)
    if "truth" in sensors:
        truth, origin = made_truth(seconds, sensors["truth"], origin, gps, recipe, say)
    if recipe.gps_from_truth:
        if truth is None:
            raise InputError(
                f"{name}: --gps-from-truth needs truth, but the log contains none; add another log with --truth"
            )
        seconds["gps"], gps = fixes_of_truth(truth, *recipe.gps_from_truth)
    speed = sensors["odometer"].values["speed"] if "odometer" in sensors else None
    drive = Drive(
        name=name,
        imu=imu,
        gps=Gps(seconds["gps"], **gps),
        truth=truth,
        frame="wgs84" if "lat" in gps else "enu",
        origin=origin,
        metadata=_metadata(recipe, zero),
        odometer=None if speed is None else Odometer(seconds["odometer"], speed),
    )
    coarse = coarse_degrees(gps)
    if shortage := shortage_of(drive.imu, drive.gps):
        shortage += f"; {coarse}" if coarse else ""
        if "overlap" in shortage:
            shortage += overlap_remedy(sensors, seconds, zero)
        raise InputError(f"{name}: {shortage}")
    if coarse:
        say(f"gps: {coarse}")
    return drive


def missing_columns(recipe: Recipe) -> Iterator[str]:
    there = {
        role: {name.removeprefix("+") for part in parts for name in part.columns}
        for role, parts in recipe.roles.items()
    }
    for role, required in REQUIRED.items():
        yield from (without_column(role, name) for name in required if name not in there.get(role, required))
    if "gps" in there and not any(pair <= there["gps"] for pair in ({"lat", "lon"}, {"x", "y"})):
        yield WITHOUT_POSITION


def assemble_imu(parts: Sequence[PartColumns], recipe: Recipe, say: Say, recording: int | None = None) -> Imu:
    samples = join(parts, "imu", REQUIRED["imu"], say, recording)
    return _imu(in_seconds({"imu": samples.time}, recipe)[0]["imu"], samples.values, recipe)


def _imu(time: Array, values: Values, recipe: Recipe) -> Imu:
    values = rotate(values, parse_mount(recipe.mount)) if recipe.mount else values
    return Imu(time, **{f.name: values[f.name] for f in fields(Imu) if f.name in values})


def _metadata(recipe: Recipe, zero: int) -> dict[str, Any]:
    """Return the keys of drive.toml. ``zero`` is the time origin, s."""
    metadata: dict[str, Any] = {"time_origin_s": zero} if zero else {}
    metadata[AXES_KEY] = recipe.imu_axes()
    if recipe.gps_from_truth:
        rate, noise = recipe.gps_from_truth
        noisy = f"white noise with a standard deviation of {noise:g} m per axis"
        metadata["gps"] = f"synthetic fixes from the truth, {rate:g} Hz, {noisy}, seed {SEED}"
    if recipe.gps_lever_arm_m:
        metadata["gps_lever_arm_m"] = list(recipe.gps_lever_arm_m)
    return with_rotation(metadata, parse_mount(recipe.mount)) if recipe.mount else metadata


def _checked_fixes(
    time: Array, fixes: Samples, origin: Origin | None, say: Say
) -> tuple[Values, Origin | None]:
    """Return the fixes with x and y, m, in the conventions of a drive, and the origin."""
    gps, origin = placed_fixes(fixes.values, origin, say, fixes.texts)
    _require_meters(time, gps, fixes.texts)
    course, rows = chord_course(time, gps["x"], gps["y"])
    for angle in ("course", "heading"):
        if angle in gps:
            gps[angle] = fitting_angle(gps[angle], course, rows, f"gps: the {angle}", say)
    return without_wrong_velocity(time, gps, "gps", fixes.texts, say), origin


def placed_fixes(
    values: Values, origin: Origin | None, say: Say, texts: Mapping[str, str] = MappingProxyType({})
) -> tuple[Values, Origin | None]:
    """Return the fixes with x and y, m, and the origin. ``texts`` are the expressions of the columns."""
    if "vx" in values and "vy" in values:
        vx, vy = values.pop("vx"), values.pop("vy")
        values["speed"], values["course"] = np.hypot(vx, vy), np.arctan2(vy, vx)
    for single in ("vx", "vy"):
        if values.pop(single, None) is not None:
            say(f"gps: {single} is left out, since a velocity needs vx and vy")
    if "course" in values:
        values["course"] = np.asarray(wrap_angle(values["course"]))
    if "lat" in values and "lon" in values:
        if not len(values["lat"]):
            raise InputError("gps: no usable fix; --show shows the contents of the log")
        origin = origin or first_place(values)
        values = add_local_position(values, values.get("alt", origin[2]), origin, "gps", texts)
    elif not {"x", "y"} <= set(values):
        raise InputError(WITHOUT_POSITION)
    for given, missing in (("std_x", "std_y"), ("std_y", "std_x")):
        if given in values and missing not in values:
            values[missing] = values[given]
    return values, origin


def _require_meters(time: Array, gps: Values, texts: Mapping[str, str]) -> None:
    """Reject x and y that imply an impossible speed, since they are not in meters."""
    apart = int(np.searchsorted(time, time[0] + 2.0)) if len(time) else 0
    if "lat" in gps or len(time) < 10 or not 0 < apart < len(time):
        return
    far = np.hypot(*(gps[n][apart:] - gps[n][:-apart] for n in ("x", "y")))
    if (speed := float(np.median(far / (time[apart:] - time[:-apart])))) > MAX_SPEED:
        texts = {n: text for n, text in texts.items() if n in ("x", "y")}
        maps = (" ".join(f'"gps.{n}=({text})*1e-{k}"' for n, text in texts.items()) for k in (3, 2))
        raise InputError(
            f"the fixes move at {speed:.4g} m/s (median), so x and y are not in m, or the times are not in s; write "
            "--map {} if x and y are in mm, or --map {} if they are in cm".format(*maps)
        )
