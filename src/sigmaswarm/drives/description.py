"""Read drive.toml: the name of a drive, its frame and origin, and other keys that filters use."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, cast

from sigmaswarm.arrays import Array
from sigmaswarm.drives.table_files import CSV, MAX_VALUE
from sigmaswarm.errors import DriveError
from sigmaswarm.file_sizes import read_toml_text
from sigmaswarm.geodesy import Origin, geodetic_to_enu
from sigmaswarm.wording import list_names, printable, printable_value, quoted

WRITE_IT = 'write this file with the line frame = "enu" (x, y) or frame = "wgs84" (lat, lon)'
Frame = Literal["enu", "wgs84"]

POSITIONS: dict[Frame, tuple[str, str]] = {"enu": ("x", "y"), "wgs84": ("lat", "lon")}
# Keys of drive.toml that filters use: allowed numbers of elements (0: a single number), and an example.
_NUMBERS: dict[str, tuple[tuple[int, ...], str]] = {
    "gps_lever_arm_m": ((2, 3), "[1.2, 0.0, 0.5]"),
    "gps_lever_arm_std_m": ((2, 3), "[0.05, 0.05, 0.1]"),
    "gps_std_m": ((0,), "1.5"),
    "heading_deg": ((0,), "90.0"),
    "imu_mounting_deg": ((3,), "[0.0, 10.0, 90.0]"),
    "accel_noise_density": ((0,), "0.004"),
    "gyro_noise_density": ((0,), "0.0001"),
    "accel_bias_walk": ((0,), "0.0001"),
    "gyro_bias_walk": ((0,), "0.00001"),
    "imu_stated_noise": ((2,), "[1e-4, 1e-2]"),
}
CUT = "cut_from"  # table in the drive.toml of a part of a drive
REPAIR_ALONE = "repair_alone"  # true: the part has other faults than the rest of the drive
CUT_KEYS = frozenset({"drive", "sha256", "start_s", "end_s", REPAIR_ALONE})  # keys of the table `CUT`
MIN_SIMILARITY = 0.8  # smallest similarity to a known key with which an unknown key counts as misspelled
_ANGLES = {
    "heading_deg": "degrees counter-clockwise from east",
    "imu_mounting_deg": "roll, pitch and yaw in degrees",
}


def read_description(path: Path) -> dict[str, Any]:
    """Read drive.toml. ``frame`` is not checked, since it depends on gps.csv."""
    if not path.is_file():
        raise DriveError(f"{path} is missing; {WRITE_IT}")
    try:
        about = tomllib.loads(read_toml_text(path))
    except OSError as error:
        raise DriveError(f"{path} can't be read ({error.strerror}); specify another file") from None
    except (ValueError, RecursionError) as error:  # the latter: lists nested 3000 deep
        coded = isinstance(error, UnicodeError)
        remedy = "write it as UTF-8" if coded else "correct that line (text needs quotes)"
        raise DriveError(f"{path} is not valid TOML: {printable(error, 160)}; {remedy}") from None
    require_name(about.get("name", "unnamed"), path)
    if "origin" in about:
        about["origin"] = _origin(about["origin"], path)
    for key in _NUMBERS:
        if key in about:
            _require_numbers(key, about[key], path)
    return about


def cut_of(about: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the table `CUT` of drive.toml or of a drive's metadata; empty if the drive was not cut."""
    cut = about.get(CUT)
    return cast("Mapping[str, Any]", cut if isinstance(cut, Mapping) else {})


def ineffective_keys(about: Mapping[str, Any], path: Path) -> Iterator[str]:
    """Yield a message for each key of drive.toml that seems intended for a filter but has no effect."""
    for key, value in about.items():
        if isinstance(value, dict):
            for inner in cast("dict[str, Any]", value):
                if inner in _NUMBERS or (key == CUT and inner not in CUT_KEYS):
                    remedy = "move it to the top of the file" if inner in _NUMBERS else "delete it"
                    yield f"{path}: {printable(inner)} in the table [{printable(key)}] has no effect; {remedy}"
        elif key not in _NUMBERS and (near := get_close_matches(key, _NUMBERS, 1, MIN_SIMILARITY)):
            yield f"{path}: the key {printable(key)} is unknown and has no effect; rename it if {near[0]} is meant"


def require_name(name: object, where: object) -> None:
    """Raise `DriveError` if a name can't be the name of a folder. ``where`` is the file that contains the name."""
    if not isinstance(name, str) or not name.strip():
        raise DriveError(
            f'{where}: name = {printable_value(name)} is empty or not text; write for example name = "monday"'
        )
    surrogates = any("\ud800" <= c <= "\udfff" for c in name)  # bytes in a file name that are not UTF-8
    if name in (".", "..") or set(name) & {"/", "\\", "\n", "\0"} or surrogates:
        what = f"{where}: name = {quoted(name)} can't be the name of a folder"
        raise DriveError(f"{what}; use letters, digits, - and _")


def _require_numbers(key: str, value: Any, path: Path) -> None:
    lengths, example = _NUMBERS[key]
    numbers = cast("list[Any]", value if isinstance(value, list) else [value])
    length = len(numbers) if isinstance(value, list) else 0
    plain = all(type(v) in (int, float) and abs(v) <= MAX_VALUE for v in numbers)
    what = None
    if not numbers or not plain or length not in lengths:
        what = f"is not valid; write for example {key} = {example}"
    elif key in _ANGLES and max(map(abs, numbers)) > 360:
        what = f"is not an angle; specify {_ANGLES[key]}, -360 to 360"
    elif key not in (*_ANGLES, "gps_lever_arm_m") and not min(numbers) > 0:
        what = "must be positive; omit the key if the value is not known"
    if what:
        raise DriveError(f"{path}: {key} = {printable_value(value)} {what}")


def _origin(value: Any, path: Path) -> Origin:
    if isinstance(value, list) and [type(v) in (int, float) for v in cast("list[Any]", value)] == [True] * 3:
        latitude, longitude, altitude = cast("list[float]", value)
        if abs(latitude) <= 90 and abs(longitude) <= 180 and abs(altitude) <= 1e7:
            return float(latitude), float(longitude), float(altitude)
    raise DriveError(
        f"{path}: origin = {printable_value(value)} is not a position; write origin = [latitude deg, longitude deg, "
        "altitude m]"
    )


def frame_of(stated: Any, gps: Path, columns: Sequence[str]) -> Frame:
    """Return the stated frame of the fixes, which must agree with the columns, or the columns' frame if it is None."""
    description = gps.parent / "drive.toml"
    if stated not in (None, *POSITIONS):
        raise DriveError(
            f'{description}: frame = {printable_value(stated)} is unknown; write "enu" or "wgs84"'
        )
    present = [frame for frame, pair in POSITIONS.items() if set(pair) <= set(columns)]
    if not present:
        raise DriveError(
            f"{gps}{', row 1' if gps.suffix == CSV else ''}: has columns {list_names(columns)}, "
            f"but neither x, y nor lat, lon; name the positions x, y (m east, north) or lat, lon (deg)"
        )
    frame = cast("Frame", stated or present[0])
    if frame not in present:
        x, y = POSITIONS[frame]
        raise DriveError(
            f'{description}: frame = "{frame}", but {gps.name} lacks columns {x}, {y}; '
            f'write frame = "{present[0]}", which agrees with its columns'
        )
    return frame


def place_on_plane(gps: dict[str, Array], origin: Origin | None) -> Origin:
    """Add x and y (m) to the columns of a "wgs84" log. Return the origin (deg, deg, m) of x and y."""
    if origin is None:
        altitude = float(gps["alt"][0]) if "alt" in gps else 0.0
        origin = float(gps["lat"][0]), float(gps["lon"][0]), altitude
    enu = geodetic_to_enu(gps["lat"], gps["lon"], gps.get("alt", origin[2]), origin)
    gps["x"], gps["y"] = enu[:, 0], enu[:, 1]
    return origin
