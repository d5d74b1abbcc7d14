"""Reading: valid folders give the record; for others, one sentence states the place and the remedy."""

import math
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import DriveError, SigmaswarmWarning
from support import DRIVES, make_drive, needs_shared

Edit = Callable[[Path], object]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_drive(make_drive(duration=20.0), tmp_path / "good")


def rows(file: Path) -> list[list[str]]:
    return [line.split(",") for line in file.read_text().splitlines()]


def save(file: Path, table: list[list[str]]) -> None:
    file.write_text("".join(",".join(row) + "\n" for row in table))


def cell(file: str, row: int, column: str, value: str) -> Edit:
    """Put a value into line ``row`` of the file, counted as in an editor."""

    def edit(folder: Path) -> None:
        table = rows(folder / file)
        table[row - 1][table[0].index(column)] = value
        save(folder / file, table)

    return edit


def keep_rows(file: str, count: int) -> Edit:
    return lambda folder: save(folder / file, rows(folder / file)[: count + 1])


def without_column(file: str, column: str) -> Edit:
    def edit(folder: Path) -> None:
        table = rows(folder / file)
        i = table[0].index(column)
        save(folder / file, [row[:i] + row[i + 1 :] for row in table])

    return edit


def text(file: str, content: str) -> Edit:
    return lambda folder: (folder / file).write_text(content)


def delete(file: str) -> Edit:
    return lambda folder: (folder / file).unlink()


def line(file: str, row: int, content: str) -> Edit:
    def edit(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines()
        lines[row - 1] = content
        (folder / file).write_text("\n".join(lines))

    return edit


def shift_gps(seconds: float) -> Edit:
    def edit(folder: Path) -> None:
        header, *body = rows(folder / "gps.csv")
        save(folder / "gps.csv", [header, *([str(float(t) + seconds), *rest] for t, *rest in body)])

    return edit


def as_wgs84(lat: str, lon: str) -> Edit:
    """Rename the positions to lat, lon with small valid values, and put the given values into line 5."""

    def edit(folder: Path) -> None:
        _, *body = rows(folder / "gps.csv")
        save(folder / "gps.csv", [["t", "lat", "lon"], *([t, "50.0", "13.0"] for t, *_ in body)])
        cell("gps.csv", 5, "lat", lat)(folder)
        cell("gps.csv", 5, "lon", lon)(folder)
        (folder / "drive.toml").write_text('frame = "wgs84"')

    return edit


# id: (change of a good drive, parts of the message: file, row, column, value, fault, remedy)
BAD: dict[str, tuple[Edit, list[str]]] = {
    "no-such-folder": (shutil.rmtree, ["good", "does not exist", "specify a folder"]),
    "path-is-a-file": (
        lambda f: (shutil.rmtree(f), f.write_text("")),
        ["good", "is a file, not a folder", "a drive is a folder"],
    ),
    "imu-missing": (delete("imu.csv"), ["imu.csv", "is missing", "needs this table"]),
    "gps-missing": (delete("gps.csv"), ["gps.csv", "is missing", "needs this table"]),
    "toml-missing": (delete("drive.toml"), ["drive.toml", "is missing", 'frame = "enu"']),
    "file-empty": (text("imu.csv", ""), ["imu.csv", "is empty", "header line"]),
    "lever-arm-number": (
        text("drive.toml", "gps_lever_arm_m = 1.0"),
        ["gps_lever_arm_m = 1.0", "write for example"],
    ),
    "lever-arm-short": (
        text("drive.toml", "gps_lever_arm_m = [1.0]"),
        ["drive.toml", "gps_lever_arm_m = [1.0]"],
    ),
    "std-as-text": (
        text("drive.toml", 'gps_std_m = "1 m"'),
        ["drive.toml", "gps_std_m = '1 m'", "write for example"],
    ),
    "mounting-short": (
        text("drive.toml", "imu_mounting_deg = 90.0"),
        ["drive.toml", "imu_mounting_deg = 90.0", "write for example imu_mounting_deg = [0.0, 10.0, 90.0]"],
    ),
    "mounting-large": (
        text("drive.toml", "imu_mounting_deg = [0.0, 0.0, 361.0]"),
        ["drive.toml", "is not an angle; specify roll, pitch and yaw in degrees"],
    ),
    "std-zero": (text("drive.toml", "gps_std_m = 0"), ["drive.toml", "gps_std_m = 0", "positive"]),
    "name-with-slash": (text("drive.toml", 'name = "../up"'), ["drive.toml", "'../up'", "use letters"]),
    "file-header-only": (keep_rows("gps.csv", 0), ["gps.csv", "contains no rows", "one row per sample"]),
    "file-blank-lines-only": (text("truth.csv", "t,x\n\n\n"), ["truth.csv", "contains no rows"]),
    "not-utf8": (
        lambda f: (f / "imu.csv").write_bytes(b"t,ax\n1,\xff\xfe\n"),
        ["imu.csv", "UTF-8", "export"],
    ),
    "imu-column-missing": (
        without_column("imu.csv", "gz"),
        ["imu.csv", "row 1", "no column gz", "t, ax, ay, az, gx, gy", "add it, or rename"],
    ),
    "truth-column-missing": (without_column("truth.csv", "theta"), ["truth.csv", "row 1", "no column theta"]),
    "time-missing": (without_column("gps.csv", "t"), ["gps.csv", "row 1", "no column t"]),
    "column-twice": (
        line("imu.csv", 1, "t,ax,ax,gz,az,gx,gy"),
        ["imu.csv", "row 1", "'ax'", "twice", "rename"],
    ),
    "column-twice-spaced": (
        line("imu.csv", 1, "t,ax,ay,gz, ax,gx,gy"),
        ["imu.csv", "row 1", "'ax'", "twice"],
    ),
    "row-too-short": (
        line("imu.csv", 7, "0.05,1,2"),
        ["imu.csv", "row 7", "'0.05,1,2'", "3 cells", "7", "complete"],
    ),
    "row-too-long": (
        line("gps.csv", 9, "1,2,3,4"),
        ["gps.csv", "row 9", "'1,2,3,4'", "4 cells", "3", "delete"],
    ),
    "decimal-comma": (line("gps.csv", 9, "1,2,3,4,5,6"), ["gps.csv", "row 9", "with a dot"]),
    "not-a-number": (
        cell("imu.csv", 40, "ay", "abc"),
        ["imu.csv", "row 40", "column ay", "'abc'", "not a finite number", "delete the row"],
    ),
    "nan": (
        cell("imu.csv", 41, "gz", "NaN"),
        ["imu.csv", "row 41", "column gz", "'NaN'", "not a finite", "delete"],
    ),
    "infinite": (
        cell("truth.csv", 3, "vx", "-inf"),
        ["truth.csv", "row 3", "column vx", "'-inf'", "not a finite"],
    ),
    "too-large-for-a-float": (cell("gps.csv", 3, "x", "1e999"), ["gps.csv", "row 3", "column x", "'1e999'"]),
    "cell-empty": (
        cell("gps.csv", 12, "y", ""),
        ["gps.csv", "row 12", "column y", "''", "is empty", "fill it in"],
    ),
    "cell-blank": (cell("gps.csv", 2, "y", "  "), ["gps.csv", "row 2", "column y", "is empty", "fill it in"]),
    "time-repeated": (
        cell("imu.csv", 6, "t", "0.03"),
        ["imu.csv", "row 6", "column t", "'0.03'", "not after 0.03", "row 5", "sort"],
    ),
    "time-backwards": (
        cell("gps.csv", 4, "t", "0.2"),
        ["gps.csv", "row 4", "column t", "'0.2'", "row 3", "sort"],
    ),
    "truth-time-backwards": (
        cell("truth.csv", 4, "t", "0"),
        ["truth.csv", "row 4", "column t", "'0'", "row 3"],
    ),
    "latitude": (
        as_wgs84("95.5", "13"),
        ["gps.csv", "row 5", "column lat", "'95.5'", "-90 to 90", "exchanged"],
    ),
    "longitude": (
        as_wgs84("50", "347"),
        ["gps.csv", "row 5", "column lon", "'347'", "-180 to 180", "subtract 360"],
    ),
    "no-overlap": (
        shift_gps(500.0),
        ["imu.csv", "gps.csv", "0.0 to 20.0 s", "500.", "do not overlap", "clock"],
    ),
    "few-fixes": (keep_rows("gps.csv", 9), ["gps.csv", "9 fixes", "too few", "at least 10"]),
    "few-fixes-shared": (shift_gps(18.5), ["gps.csv", "7 fixes within the IMU's time span", "at least 10"]),
    "few-samples": (keep_rows("imu.csv", 99), ["imu.csv", "99 samples", "too few", "at least 100"]),
    "no-positions": (
        line("gps.csv", 1, "t,east,north"),
        [
            "gps.csv",
            "row 1",
            "has columns t, east, north, but neither x, y nor lat, lon",
            "name the positions",
        ],
    ),
    "toml-invalid": (
        text("drive.toml", "name = drive"),
        ["drive.toml", "not valid TOML", "line 1", "quotes"],
    ),
    "name-not-text": (text("drive.toml", "name = 5"), ["drive.toml", "name = 5", "write for example"]),
    "name-empty": (text("drive.toml", 'name = " "'), ["drive.toml", "name = ' '", "write for example"]),
    "frame-unknown": (
        text("drive.toml", 'frame = "utm"'),
        ["drive.toml", "'utm'", "unknown", '"enu" or "wgs84"'],
    ),
    "frame-not-text": (text("drive.toml", "frame = [1]"), ["drive.toml", "[1]", "unknown"]),
    "frame-disagrees": (
        text("drive.toml", 'frame = "wgs84"'),
        ["drive.toml", 'frame = "wgs84"', "lacks columns lat, lon", 'write frame = "enu"'],
    ),
    **{
        f"origin-{i}": (
            text("drive.toml", f"origin = {value}"),
            ["drive.toml", "origin = ", "write origin = ["],
        )
        for i, value in enumerate(
            ["[1, 2]", "[91, 0, 0]", "[0, 181, 0]", "[nan, 0, 0]", "'here'", "[true, 0, 0]"]
        )
    },
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_names_place_and_remedy_in_one_line(folder: Path, case: str):
    edit, expected = BAD[case]
    edit(folder)
    with pytest.raises(DriveError) as caught:
        read_drive(folder)
    message = str(caught.value)
    assert [part for part in expected if part not in message] == [], message
    assert message.startswith(str(folder))
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("value", ["0", "-1.5"])
def test_a_stated_deviation_is_positive(folder: Path, value: str):
    table = rows(folder / "gps.csv")
    save(folder / "gps.csv", [[*row, "std_x" if i == 0 else "1.5"] for i, row in enumerate(table)])
    read_drive(folder)
    cell("gps.csv", 8, "std_x", value)(folder)
    with pytest.raises(
        DriveError, match=rf"gps.csv, row 8, column std_x: '{value}' is outside .*; omit the column"
    ):
        read_drive(folder)


def test_the_truth_s_deviations_are_positive_and_whole(folder: Path):
    table = rows(folder / "truth.csv")
    save(folder / "truth.csv", [[*row, "std_x" if i == 0 else "0.5"] for i, row in enumerate(table)])
    with pytest.raises(
        DriveError,
        match=r"truth.csv: Truth accepts std_x and std_y only together, .*; add the missing arrays",
    ):
        read_drive(folder)
    both = rows(folder / "truth.csv")
    save(folder / "truth.csv", [[*row, "std_y" if i == 0 else "0.5"] for i, row in enumerate(both)])
    assert read_drive(folder).truth.std_y[3] == 0.5
    cell("truth.csv", 8, "std_y", "0")(folder)
    with pytest.raises(
        DriveError, match=r"truth.csv, row 8, column std_y: '0' is outside .*; omit the column"
    ):
        read_drive(folder)


def test_blank_lines_count_as_lines_but_not_as_rows(folder: Path):
    before = read_drive(folder)
    lines = (folder / "imu.csv").read_text().splitlines()
    (folder / "imu.csv").write_text("\n".join([*lines[:10], "", *lines[10:], "", ""]))
    np.testing.assert_array_equal(read_drive(folder).imu.time, before.imu.time)
    cell("imu.csv", 20, "ax", "?")(folder)
    with pytest.raises(DriveError, match=r"row 20, column ax: '\?'"):
        read_drive(folder)


@pytest.mark.parametrize("cell", ['"', '",1.0,2.0'])
def test_a_single_quote_instead_of_a_number_gives_one_clear_line(
    folder: Path, cell: str, capfd: pytest.CaptureFixture[str]
):
    with (folder / "gps.csv").open("a") as file:
        file.write(cell)
    with pytest.raises(DriveError, match=r"gps\.csv"):
        read_drive(folder)
    assert capfd.readouterr().err == ""


def test_spaces_quotes_line_ends_and_a_byte_order_mark_are_accepted(folder: Path):
    before = read_drive(folder)
    body = (folder / "imu.csv").read_text().replace(",", ", ").replace("ax", '"ax"').replace(' "ax"', '"ax"')
    (folder / "imu.csv").write_bytes(b"\xef\xbb\xbf" + body.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_drive(folder).imu.ay, before.imu.ay)


def test_unknown_columns_are_ignored_with_a_warning(folder: Path):
    table = rows(folder / "imu.csv")
    save(folder / "imu.csv", [[*row, "temperature" if i == 0 else "warm"] for i, row in enumerate(table)])
    with pytest.warns(
        SigmaswarmWarning, match=r"imu.csv: ignoring 'temperature'; the known columns are t, ax"
    ) as caught:
        read_drive(folder)
    assert caught[0].filename == __file__


def test_keys_of_drive_toml(folder: Path):
    (folder / "drive.toml").write_text('licence = "MIT"\norigin = [50, 13, 120.5]\n[lever_arm]\nx = 0.5\n')
    drive = read_drive(folder)
    assert drive.name == "good"  # the name of the folder
    assert drive.frame == "enu"  # from the names of the columns
    assert drive.origin == (50.0, 13.0, 120.5)
    assert drive.metadata == {"licence": "MIT", "lever_arm": {"x": 0.5}}


def wgs84_folder(folder: Path, toml: str, alt: str | None) -> Path:
    _, *body = rows(folder / "gps.csv")
    table = [
        ["t", "lat", "lon", "alt"],
        *([r[0], f"{51 + i * 1e-5}", "13.8", f"{alt}"] for i, r in enumerate(body)),
    ]
    save(folder / "gps.csv", table if alt else [row[:3] for row in table])
    (folder / "drive.toml").write_text(toml)
    return folder


# 1e-5 deg of latitude in the tangent plane at 51 deg north: M = a (1 - e2) / (1 - e2 sin2)^1.5
_A, _E2 = 6378137.0, 0.00669437999014
NORTH_STEP = math.radians(1e-5) * _A * (1 - _E2) / (1 - _E2 * math.sin(math.radians(51)) ** 2) ** 1.5


@pytest.mark.parametrize(
    ("toml", "alt", "origin"),
    [
        ("", "100.0", (51.0, 13.8, 100.0)),
        ('frame = "wgs84"', None, (51.0, 13.8, 0.0)),
        ("origin = [51.0, 13.8, 2000.0]", None, (51.0, 13.8, 2000.0)),
    ],
)
def test_wgs84_fixes_are_relative_to_the_origin(
    folder: Path, toml: str, alt: str | None, origin: tuple[float]
):
    drive = read_drive(wgs84_folder(folder, toml, alt))
    assert (drive.frame, drive.origin) == ("wgs84", origin)
    # Without altitudes, fixes are placed at the altitude of the origin, so their distances are larger.
    height = 1 + origin[2] / 6.38e6
    np.testing.assert_allclose(drive.gps.y, np.arange(len(drive.gps)) * NORTH_STEP * height, rtol=3e-6)
    np.testing.assert_allclose(drive.gps.x, 0.0, atol=1e-6)
    assert drive.gps.lat is not None
    assert drive.gps.lat[1] == 51.00001
    assert (drive.gps.alt is None) == (alt is None)


@needs_shared
@pytest.mark.parametrize(
    "name", ["colorado-1", "comma2k19", "dresden", "kingston-1", "kitti-09-30-0033", "kitti-09-30-0034"]
)
def test_good_real_drives_read_without_a_warning(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drive = read_drive(DRIVES / name)
    assert drive.name == name
    assert drive.metadata["licence"]
    assert (drive.truth is None) == (name == "dresden")


@needs_shared
def test_real_drive_in_degrees():
    drive = read_drive(DRIVES / "dresden")
    assert drive.origin == (51.039553, 13.792498, 111.52)
    assert drive.gps.speed is not None
    steps = np.hypot(np.diff(drive.gps.x[::10]), np.diff(drive.gps.y[::10]))  # at 10 Hz, noise would add up
    travelled = np.sum(drive.gps.speed[1:] * np.diff(drive.gps.time))
    assert steps.sum() == pytest.approx(travelled, rel=0.05)  # compared with the speed of the receiver


def test_keys_without_effect_are_reported(tmp_path: Path):
    """A key that is appended to drive.toml belongs to the last table."""
    folder = write_drive(make_drive(duration=5.0), tmp_path / "a")
    text = 'frame = "enu"\ngps_std = 1.0\nnote = "x"\n[cut_from]\ndrive = "b"\ncolor = 1\ngps_std_m = 2.0\n'
    (folder / "drive.toml").write_text(text)
    with pytest.warns(SigmaswarmWarning) as found:
        drive = read_drive(folder)
    assert "gps_std_m" not in drive.metadata
    assert [str(one.message).removeprefix(f"{folder / 'drive.toml'}: ") for one in found] == [
        "the key gps_std is unknown and has no effect; rename it if gps_std_m is meant",
        "color in the table [cut_from] has no effect; delete it",
        "gps_std_m in the table [cut_from] has no effect; move it to the top of the file",
    ]
