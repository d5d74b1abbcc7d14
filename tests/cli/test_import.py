"""`sigmaswarm import`: from a bag to an evaluation, `--show`, and mistakes in one line."""

import importlib
import json
import re
import shlex
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sigmaswarm as library
from importing.bags import messages, write_mcap, write_ros
from importing.logs import EPOCH, a_drive
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.geodesy import enu_to_geodetic, wrap_angle
from support import some

ORIGIN = (50.0, 8.0, 100.0)
PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
Command = Callable[..., Any]


def simulated() -> Drive:
    """Return a simulated drive with all columns; fixes in degrees."""
    drive = library.simulate("urban", run=3, duration=40.0, imu_rate=50.0, gps="white-1m")
    fixes = len(drive.gps)
    lat, lon, alt = enu_to_geodetic(np.column_stack([drive.gps.x, drive.gps.y, np.zeros(fixes)]), ORIGIN).T
    rng = np.random.default_rng(0)
    std, motion = rng.uniform(0.5, 2.0, (2, fixes)), (rng.uniform(3, 14, fixes), rng.uniform(-3, 3, fixes))
    gps = Gps(drive.gps.time, drive.gps.x, drive.gps.y, lat, lon, alt, *std, *motion)
    return Drive("bagged", drive.imu, gps, drive.truth, "wgs84", ORIGIN)


@pytest.fixture(scope="module")
def bagged(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return an MCAP file, written once."""
    return write_mcap(tmp_path_factory.mktemp("bagged") / "log.mcap", messages(a_drive())).read_bytes()


def test_the_remedy_of_mirrored_fixes_names_the_columns_of_the_log(sigmaswarm: Command, here: Path):
    drive = library.simulate("urban", run=3, duration=90.0, imu_rate=50.0, gps="white-1m")
    pl.DataFrame({n: v for n, v in vars(drive.imu).items() if v is not None}).write_csv("imu.csv")
    pl.DataFrame({"time": drive.gps.time, "x": drive.gps.y, "y": drive.gps.x}).write_csv("gps.csv")
    ended = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "drive")
    maps = re.findall(r'"(gps\.[xy]=\w+)"', " ".join(ended.out.split()))
    ended = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "right", "--map", *maps)
    assert maps == ["gps.x=y", "gps.y=x"] and "mirrored-fixes" not in ended.out


def test_the_remedy_of_a_velocity_of_the_vehicle_omits_the_columns(sigmaswarm: Command, here: Path):
    drive = library.simulate("urban", run=3, duration=90.0, imu_rate=50.0, gps="white-1m")
    gps, truth = drive.gps, drive.truth
    assert truth is not None
    pl.DataFrame({n: v for n, v in vars(drive.imu).items() if v is not None}).write_csv("imu.csv")
    forward = np.interp(gps.time, truth.time, np.hypot(truth.vx, truth.vy))
    places = {"time": gps.time, "x": gps.x, "y": gps.y}
    pl.DataFrame(places | {"vx": forward, "vy": 0 * forward}).write_csv("gps.csv")
    ended = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "drive")
    assert "course-convention" in ended.out
    maps = re.findall(r'"(gps\.\w+=)"', " ".join(ended.out.split()))
    ended = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "right", "--map", *maps)
    assert maps == ["gps.vx=", "gps.vy="] and "course-convention" not in ended.out


def test_from_a_bag_to_a_bag_with_the_estimate(sigmaswarm: Command, here: Path, tuned: Path):
    from rosbags.highlevel import AnyReader

    write_ros(here / "monday", messages(simulated()), "mcap")
    assert sigmaswarm("import", "monday", "--out", "drive").code == 0
    ended = sigmaswarm("run", tuned, "drive", "--out", "estimate.ros2", "--merge", "monday")
    assert (ended.code, ended.err) == (0, "")
    assert "Foxglove: import estimate.ros2/foxglove-layout.json as a layout" in ended.out
    with AnyReader([here / "monday"]) as before, AnyReader([here / "estimate.ros2"]) as after:
        counts = {topic: info.msgcount for topic, info in after.topics.items()}
        assert counts.pop("/sigmaswarm/odometry") > 1000
        own = {topic: counts.pop(topic) for topic in [*counts] if topic.startswith("/sigmaswarm/")}
        assert own.keys() == {
            f"/sigmaswarm/{n}" for n in ("fix", "sigma", "innovation", "innovation_sigma", "nis")
        }
        assert min(own.values()) > 100
        assert counts == {topic: info.msgcount for topic, info in before.topics.items()}
        assert before.start_time <= after.start_time and after.end_time <= before.end_time
    ended = sigmaswarm("run", tuned, "drive", "--out", "estimate.tum", "--merge", "monday")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    ended = sigmaswarm(
        "run", tuned, "drive", "--out", "e.ros2", "--beside", "tuesday"
    )  # the option's name in 0.3.0
    assert ended.code == 2
    assert "tuesday: no such bag" in ended.err


@pytest.mark.long
def test_from_a_bag_to_an_evaluation(sigmaswarm: Command, here: Path):
    drive = simulated()
    write_ros(here / "bag", messages(drive))
    ended = sigmaswarm("import", "bag", "--out", "drives/monday", "--origin", "50,8,100")
    assert ended.code == 0, ended.err
    assert "note: /imu/data is in the frame 'imu_link'" in ended.out
    assert "wrote drives/monday: 40.0 s" in ended.out
    assert "importing" in ended.err  # progress
    assert "\nnext: sigmaswarm split drives/monday --out parts\n" in ended.out

    got = library.read_drive(here / "drives" / "monday")
    assert got.metadata["time_origin_s"] == EPOCH
    for table, columns in (("imu", "ax ay az gx gy gz"), ("gps", "lat lon alt"), ("truth", "x y")):
        for column in columns.split():
            np.testing.assert_array_equal(
                getattr(getattr(got, table), column), getattr(getattr(drive, table), column)
            )
    for table, columns in (
        ("imu", "time"),
        ("gps", "time std_x std_y"),  # random speeds, which contradict the positions, are omitted
        ("truth", "time vx vy"),
    ):
        for column in columns.split():
            a, b = getattr(getattr(got, table), column), getattr(getattr(drive, table), column)
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-9, err_msg=column)  # timestamps are in whole ns
    np.testing.assert_allclose(got.gps.x, drive.gps.x, atol=5e-9)
    np.testing.assert_allclose(wrap_angle(got.truth.theta - drive.truth.theta), 0, atol=1e-12)

    ended = sigmaswarm(
        *("tune", "drives/monday", "--out", "tuned", "--particles", "16", "--generations", "3", "--json"),
        *("--objective", "truth-pose"),
    )
    assert ended.code == 0, ended.err
    ended = sigmaswarm("evaluate", "tuned", "drives/monday", "--json")
    assert ended.code == 0, ended.err
    assert "monday" in ended.out


def test_show_writes_nothing_and_its_recipe_can_be_used(sigmaswarm: Command, here: Path, bagged: bytes):
    (here / "log.mcap").write_bytes(bagged)
    ended = sigmaswarm("import", "log.mcap", "--show")
    assert "[[imu]]" not in ended.out and "\nread imu from /imu/data: t=" in ended.out
    assert "orientation.x" not in ended.out.split("\nread imu from")[0]
    ended = sigmaswarm("import", "log.mcap", "--show", "--verbose")
    assert ended.code == 0, ended.err
    for said in (
        "/imu/data: sensor_msgs/msg/Imu, 601 rows, 100 Hz",
        "linear_acceleration.x",
        "[[imu]]",
        "latitude",
    ):
        assert said in ended.out, said
    assert [path.name for path in here.iterdir()] == ["log.mcap"]
    ended = sigmaswarm("import", "log.mcap", "--show", "--json", "--save-recipe", "recipe.toml")
    assert {table["table"] for table in json.loads(ended.out)["tables"]} >= {"/imu/data", "/gps/fix"}
    first = sigmaswarm("import", "log.mcap", "--out", "a")
    second = sigmaswarm("import", "log.mcap", "--out", "b", "--recipe", "recipe.toml", "--json")
    assert first.code == second.code == 0
    assert json.loads(second.out)["fixes"] == 30
    for file in ("imu.csv", "gps.csv", "truth.csv"):
        assert (here / "a" / file).read_bytes() == (here / "b" / file).read_bytes()


def test_options_reach_the_drive(sigmaswarm: Command, here: Path, bagged: bytes):
    (here / "log.mcap").write_bytes(bagged)
    ended = sigmaswarm(
        *(
            "import",
            "log.mcap",
            "--out",
            "out",
            "--mount",
            "-90",
            "--gps-offset",
            "-0.05",
            "--lever-arm",
            "-1.2,0,0.5",
        ),
        *("--map", "az=2*linear_acceleration.z", "--name", "tuesday", "--gps-topic", "/gps/fix"),
    )
    assert ended.code == 0, ended.err
    drive = a_drive()
    with pytest.warns(library.SigmaswarmWarning, match="column az"):
        got = library.read_drive(here / "out")
    np.testing.assert_allclose(got.imu.ax, drive.imu.ay)
    np.testing.assert_allclose(got.imu.az, 2 * drive.imu.az)
    assert np.median(got.gps.time - drive.gps.time) == pytest.approx(-0.05, abs=1e-6)
    assert got.name == "tuesday" and got.metadata["gps_lever_arm_m"] == [-1.2, 0.0, 0.5]
    assert "az" in ended.out  # the warning states that gravity is twice as large


@pytest.mark.parametrize("more", [(), ("--format", "csv")])
@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({}, "log: is an empty folder; specify a log file or the folder of a log"),
        (
            {"notes.txt": "hello\n"},
            "log: contains no log of a known format (it contains notes.txt); specify a log",
        ),
        (
            {"a.csv": "", "b.doc": "."},
            "log: contains no log of a known format (it contains a.csv, b.doc); specify a log file or",
        ),
    ],
)
def test_a_folder_without_a_log(
    sigmaswarm: Command, here: Path, files: dict[str, str], said: str, more: tuple[str, ...]
):
    (here / "log").mkdir()
    for name, text in files.items():
        (here / "log" / name).write_text(text)
    for action in (("--show",), ("--out", "drive")):
        ended = sigmaswarm("import", "log", *action, *more)
        lines = [line for line in ended.err.splitlines() if not line.startswith("importing")]
        assert (ended.code, ended.out, len(lines)) == (2, "", 1) and said in lines[0], ended.err


def test_notes_next_to_a_log_are_not_read(sigmaswarm: Command, here: Path):
    (here / "log").mkdir()
    rows = [f"{i / 100},0,0,0,{i},0" for i in range(300)]
    (here / "log" / "log.csv").write_text("t,ax,ay,gz,x,y\n" + "\n".join(rows) + "\n")
    (here / "log" / "notes.txt").write_text("hello\n")
    ended = sigmaswarm("import", "log", "--out", "drive")
    assert ended.code == 0, ended.err
    assert "note: notes.txt: is not a table and is not read" in ended.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere", "--out", "out"), "nowhere does not exist"),
        (("log.mcap",), "--out is missing: specify a folder for the drive"),
        (("log.mcap", "--out", "out", "--format", "rosbag"), "--format 'rosbag' is unknown; perhaps"),
        (("log.mcap", "--out", "out", "--format", "ros"), "log.mcap"),
        (("notes.md", "--out", "out"), "has an unknown format"),
        ((".", "--out", "out", "--format", "px4"), ".: is a folder; specify the px4 file in it"),
        (("log.mcap", "--out", "out", "--imu-topic", "/imu7"), "no topic '/imu7'"),
        (("log.mcap", "--out", "out", "--mount", "sideways"), "mount 'sideways'"),
        (("log.mcap", "--out", "out", "--origin", "1,2"), "--origin '1,2' is not 3 numbers"),
        (("log.mcap", "--out", "out", "--map", "ax=open('x')"), "is not allowed"),
        (("log.mcap", "--out", "out", "--map", "wheel=1"), "no column 'wheel'"),
        (("log.mcap", "--out", "out", "--recipe", "none.toml"), "none.toml: can't be read"),
        (("log.mcap", "--out", "out", "--gps-offset", "100"), "do not overlap"),
        (("log.mcap", "--out", "full"), "is not part of a drive"),
        (("cut.mcap", "--out", "out"), "cut.mcap: is cut short or broken"),
    ],
)
def test_mistakes_are_one_line(
    sigmaswarm: Command, here: Path, bagged: bytes, arguments: tuple[str, ...], said: str
):
    (here / "log.mcap").write_bytes(bagged)
    (here / "cut.mcap").write_bytes(bagged[: len(bagged) // 2])
    (here / "notes.md").write_text("# notes\n")
    (here / "full").mkdir()
    (here / "full" / "thesis.txt").write_text("precious")
    ended = sigmaswarm("import", *arguments, *(["--overwrite"] if "full" in arguments else []))
    lines = [line for line in ended.err.splitlines() if not line.startswith("importing")]
    assert ended.code == 2
    assert len(lines) == 1 and said in lines[0], ended.err
    assert not (here / "out").exists()
    if "full" in arguments:
        assert "importing" not in ended.err  # reported before any work
        first = sigmaswarm("import", *arguments)  # --overwrite would not help
        assert (first.code, first.err) == (2, ended.err) and "--overwrite" not in first.err


@pytest.mark.parametrize(
    ("file", "content", "library_name", "extra"),
    [
        ("log.mcap", b"\x89MCAP0\r\n", "mcap", "ros"),
        ("log.bag", b"#ROSBAG V2.0\n", "rosbags", "ros"),
        ("log.ubx", b"\xb5\x62\x01\x07", "pyubx2", "logs"),
        ("log.nmea", b"$GNGGA,", "pynmeagps", "logs"),
        ("log.ulg", b"ULog\x01\x12\x35", "pyulog", "logs"),
    ],
)
def test_a_missing_library_is_named(
    sigmaswarm: Command,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    file: str,
    content: bytes,
    library_name: str,
    extra: str,
):
    (here / file).write_bytes(content)
    for name in [n for n in sys.modules if n == library_name or n.startswith(library_name + ".")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library_name, None)  # simulates a missing library
    with pytest.raises(ImportError):
        importlib.import_module(library_name)
    ended = sigmaswarm("import", file, "--out", "out")
    assert ended.code == 2
    extras = tomllib.loads(PYPROJECT.read_text())["project"]["optional-dependencies"]
    packages = " ".join(name.split(">")[0] for name in extras[extra])
    assert library_name in packages
    assert f"needs {library_name}, which is not installed; run: pip install {packages}\n" in ended.err


def test_help_names_every_format(sigmaswarm: Command):
    from sigmaswarm.importing.formats import READERS

    said = " ".join(sigmaswarm("import", "--help").out.split())
    for name in READERS:
        assert name in said


def test_a_drive_that_can_not_be_read_is_not_written(sigmaswarm: Command, here: Path):
    """The existing drive is kept, and the name is refused before the log is read."""
    rows = [f"{i / 100},0,0,0,{i},0" for i in range(300)]
    (here / "log.csv").write_text("t,ax,ay,gz,x,y\n" + "\n".join(rows) + "\n")
    assert sigmaswarm("import", "log.csv", "--out", "drive").code == 0
    before = {path.name: path.read_bytes() for path in (here / "drive").iterdir()}
    for arguments, said in (
        (("--map", "gps.x=x*1e9"), "x and y are not in m"),
        (("--name", "a/b"), "name = 'a/b'"),
    ):
        ended = sigmaswarm("import", "log.csv", "--out", "drive", "--overwrite", *arguments)
        lines = [line for line in ended.err.splitlines() if not line.startswith("importing")]
        assert ended.code == 2 and len(lines) == 1 and said in lines[0], ended.err
        assert {path.name: path.read_bytes() for path in (here / "drive").iterdir()} == before


def test_names_of_columns_can_not_control_the_terminal(sigmaswarm: Command, here: Path):
    """Escape sequences in column names, cells and table names are shown as text."""
    rows = [f"{i / 100},0,0,0,{i},0,\x1b[31mred\x9b" for i in range(300)]
    (here / "log\x1b[2J.csv").write_text("t,ax,ay,gz,x,y,\x1b]0;owned\x07\n" + "\n".join(rows) + "\n")
    (here / "two").mkdir()
    (here / "log\x1b[2J.csv").rename(here / "two" / "log\x1b[2J.csv")
    (here / "two" / "b.csv").write_text("a,b\n1,2\n")
    ended = sigmaswarm("import", "two", "--show")
    assert ended.code == 0, ended.err
    assert "\\x1b]0;owned\\x07" in ended.out and "log\\x1b[2J.csv" in ended.out
    assert not {"\x1b", "\x07", "\x9b"} & set(ended.out), repr(ended.out)


def test_show_lists_unused_columns(sigmaswarm: Command, here: Path):
    rows = [f"{i / 100},0,0,9.81,{20 + i % 3},0,{i},0,3" for i in range(300)]
    names = ["t", "ax", "ay", "AccelUp", "Engine Temp (C)", "gz", "x", "y", "fix_type"]
    (here / "log.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    said = sigmaswarm("import", "log.csv", "--show").out
    assert "\nnot used from log.csv: Engine Temp (C), fix_type\n" in said, said
    assert "\nnext: sigmaswarm import log.csv --out drive " in said
    (here / "drive").mkdir()
    (here / "drive" / "imu.csv").touch()
    said = sigmaswarm("import", "log.csv", "--show").out
    assert "next: sigmaswarm import log.csv --out drive-2 " in said, "no earlier drive is replaced"


@pytest.mark.parametrize(
    ("header", "options", "fault"),
    [
        ("ax,ay,gz,lat,lon", [], "log.csv: no column is recognized as the time of the imu; if the rate is known"),
        ("ax,ay,gz,lat,lon", [], "for example --time row/100 for 100 Hz (replace 100 by the rate of this log)"),
        ("ax,ay,gz,lat,lon", ["--map", "imu.t=row/100"], "is recognized as the time of the gps; if the rate is known"),
        ("t,ax,ay,q,lat,lon", [], "the IMU has no column for gz (the yaw rate); specify a log"),
        ("t,ax,ay,q,lat,lon", ["--map", "imu.ax=ax", "imu.ay=ay"], "imu: no column contains gz; specify one with"),
        ("t,ax,ay,gz,lat,q", ["--map", "gps.lat=lat"], "gps: no column contains a position; map lat and lon"),
        ("t,ax,ay,gz,lat,lon", ["--imu-topic", "log.csv", "--map", "ax=bx"], "'bx'"),
        ("t,ax,ay,gz,lat,lon", ["--map", "t=t*1000"], "rows of the imu would be 10 s apart"),
    ],
)  # fmt: skip
def test_show_states_the_faults_of_columns_that_import_states(
    sigmaswarm: Command, here: Path, header: str, options: list[str], fault: str
):
    names = header.split(",")
    rows = [",".join(str(i / 100 if n == "t" else i % 7 / 1000) for n in names) for i in range(300)]
    (here / "log.csv").write_text(header + "\n" + "\n".join(rows) + "\n")
    shown = sigmaswarm("import", "log.csv", "--show", *options)
    assert shown.code == 0 and fault in shown.out and "next: " not in shown.out, shown.out
    assert "The log cannot be imported yet: follow the notes above, and repeat --show" in shown.out
    ended = sigmaswarm("import", "log.csv", "--out", "drive", *options)
    assert ended.code == 2 and fault in ended.err, ended.err


def test_row_numbers_follow_the_proposal_of_show(sigmaswarm: Command, here: Path):
    drive = simulated()
    fixes = {n: np.interp(drive.imu.time, drive.gps.time, getattr(drive.gps, n)) for n in ("lat", "lon")}
    columns = {"ax": drive.imu.ax, "ay": drive.imu.ay, "gz": drive.imu.gz, **fixes}
    pl.DataFrame(columns).write_csv(here / "log.csv")
    said = sigmaswarm("import", "log.csv", "--show").out
    assert 'agrees at 50 rows per s; write --map "imu.t=row/50" "gps.t=row/50"\n' in said
    said = sigmaswarm("import", "log.csv", "--show", "--time", "row/50").out
    assert "next: sigmaswarm import log.csv --time row/50 --out drive\n" in said and "50 Hz" in said, said
    assert sigmaswarm("import", "log.csv", "--out", "drive", "--time", "row/50").code == 0
    np.testing.assert_allclose(library.read_drive(here / "drive").imu.time, drive.imu.time, atol=1e-6)


def test_show_names_the_mounting_that_its_note_recommends(sigmaswarm: Command, here: Path):
    rows = [f"{i / 100},0,0,-9.81,0,{i},0" for i in range(300)]
    (here / "log.csv").write_text("t,ax,ay,az,gz,x,y\n" + "\n".join(rows) + "\n")
    said = sigmaswarm("import", "log.csv", "--show").out
    command = "sigmaswarm import log.csv --out drive --mount x=x,y=-y"
    assert "the z axis points down" in said and f"\nnext: {command}\n" in said
    with_mount = sigmaswarm("import", "log.csv", "--show", "--mount", "x=x,y=-y").out
    assert "points down" not in with_mount and with_mount.count("--mount") == 1


@pytest.mark.parametrize(
    ("force", "mount"),
    [
        ("0,8.9,3.8", "auto"),
        ("0.5,-8.5,-4.9", "auto"),
        ("0,0.5,-9.8", "x=x,y=-y"),
        ("1.5,0,9.7", ""),
    ],
)
def test_show_proposes_mount_auto_if_gravity_is_not_on_z(
    sigmaswarm: Command, here: Path, force: str, mount: str
):
    """A phone in a holder was imported as if it were horizontal; accelerations without gravity show no direction."""
    rows = [f"{i / 100},{force},0,0,0,{i},0" for i in range(300)]
    (here / "log.csv").write_text("t,ax,ay,az,gx,gy,gz,x,y\n" + "\n".join(rows) + "\n")
    said = sigmaswarm("import", "log.csv", "--show").out
    (command,) = re.findall(r"next: (sigmaswarm .*)\n", said)
    assert command == f"sigmaswarm import log.csv --out drive {f'--mount {mount}' if mount else ''}".rstrip()
    assert ("; --mount auto estimates the rotation" in said) == (mount == "auto")
    assert "gravity" not in sigmaswarm("import", "log.csv", "--show", "--mount", "0,0,90").out


@pytest.mark.parametrize("option", ["--max-rows", "--max-columns", "--max-unpacked-mb"])
def test_limits_are_options(sigmaswarm: Command, here: Path, option: str):
    rows = [f"{i / 100},0,0,0,{i},0" for i in range(300)]
    (here / "log.csv").write_text("t,ax,ay,gz,x,y\n" + "\n".join(rows) + "\n")
    assert sigmaswarm("import", "log.csv", "--out", "a", option, "300").code == 0
    ended = sigmaswarm("import", "log.csv", "--out", "b", option, "0")
    assert ended.code == 2 and f"{option} 0: must be above 0" in ended.err
    if option != "--max-unpacked-mb":
        ended = sigmaswarm("import", "log.csv", "--out", "b", option, "5")
        assert ended.code == 2 and f"raise {option}" in ended.err


def test_used_columns_are_listed_without_show(sigmaswarm: Command, here: Path):
    drive = library.simulate("urban", run=3, duration=40.0, imu_rate=50.0, gps="white-1m")
    log = Path("log")
    log.mkdir()
    imu = np.column_stack(
        [1e3 * drive.imu.time, drive.imu.ax / 9.80665, drive.imu.ay / 9.80665, drive.imu.gz]
    )
    fixes = np.column_stack([1e3 * drive.gps.time, drive.gps.x, drive.gps.y])
    np.savetxt(log / "inertial.csv", imu, "%.6f", ",", header="stamp_ms,acc_x_g,acc_y_g,gyro_z", comments="")
    np.savetxt(log / "receiver.csv", fixes, "%.3f", ",", header="stamp_ms,east_m,north_m", comments="")
    ended = sigmaswarm("import", "log", "--out", "drive", "--map", "gz=1.0*gyro_z", "--verbose")
    assert ended.code == 0, ended.err
    told = [line for line in ended.out.splitlines() if line.startswith("read ")]
    assert told == [
        "read imu from inertial.csv: t=stamp_ms*1e-3, ax=acc_x_g*9.80665, ay=acc_y_g*9.80665, gz=1.0*gyro_z",
        "read gps from receiver.csv: t=stamp_ms*1e-3, x=east_m, y=north_m",
    ]
    said = json.loads(sigmaswarm("import", "log", "--out", "d2", "--map", "gz=1.0*gyro_z", "--json").out)
    assert tomllib.loads(said["recipe"])["imu"][0]["gz"] == "1.0*gyro_z"


@pytest.mark.parametrize(("kept", "unused", "severity"), [(0.5, 150, "note"), (0.4, 180, "warning")])
def test_fixes_that_no_filter_uses_are_counted_once(
    sigmaswarm: Command, here: Path, kept: float, unused: int, severity: str
):
    drive = library.simulate("urban", run=3, duration=60.0, imu_rate=50.0, gps="white-1m")
    library.write_drive(drive, here / "log")
    rows = Path("log/imu.csv").read_text().splitlines()
    Path("log/imu.csv").write_text("\n".join(rows[: round(kept * len(rows))]) + "\n")
    ended = sigmaswarm("import", "log/imu.csv", "--gps", "log/gps.csv", "--out", "drive")
    assert ended.code == 0, ended.err
    bracket = f" fixes ({unused} outside of the IMU's time span are not used), "
    assert ended.out.count(bracket) == (severity == "note")
    assert "[gps-outside] 180 of 300 fixes lie outside" in ended.out or severity == "note"
    found = json.loads(sigmaswarm("doctor", "drive", "--json").out)["drives"][0]["findings"]
    assert [f["severity"] for f in found if f["code"] == "gps-outside"] == [severity]


def test_input_files_are_not_overwritten(sigmaswarm: Command, here: Path, tuned: Path):
    """The files of a log or a drive can have the same names as the written files."""
    drive = library.write_drive(library.simulate("urban", duration=40.0, imu_rate=50.0), here / "log")
    before = {file.name: file.read_bytes() for file in drive.iterdir()}
    for source, more in ((drive, ()), (drive / "imu.csv", ("--gps", drive / "gps.csv"))):
        ended = sigmaswarm("import", source, *more, "--out", drive, "--overwrite")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "contains a log that this command reads; choose another folder" in ended.err
    for option in ("--out", "--before"):
        also = () if option == "--out" else ("--out", "estimate.csv")
        ended = sigmaswarm("run", tuned, drive, option, drive / "gps.csv", *also)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "is a file of the drive that this command reads; choose another file" in ended.err
    assert {file.name: file.read_bytes() for file in drive.iterdir()} == before


def test_the_refusal_names_every_file_that_overwrite_replaces(sigmaswarm: Command, here: Path):
    drive = library.write_drive(library.simulate("urban", duration=30.0, imu_rate=50.0), here / "log")
    options = ("import", drive, "--out", "copy", "--save-recipe", "car.toml")
    assert sigmaswarm(*options).code == 0
    assert "add --overwrite (which also replaces car.toml), or" in sigmaswarm(*options).err
    Path("car.toml").unlink()
    assert "add --overwrite, or" in sigmaswarm(*options).err


def test_several_files_in_place_of_one_are_explained(sigmaswarm: Command, here: Path):
    """A shell pattern gives several files, which Cyclopts calls unused tokens."""
    for command, takes in (
        (
            ("import", "a.csv", "b.csv", "c.csv", "--out", "x"),
            "takes one SOURCE; to pass several files, specify their folder",
        ),
        (("split", "a", "b", "c", "--out", "x"), "takes one DRIVE; run the command once for each argument"),
        (
            ("run", "t", "a", "b", "c", "--out", "x.csv"),
            "takes one TUNING and one DRIVE; run the command once",
        ),
        (("study", "a", "b", "--out", "x"), "takes only options"),
    ):
        ended = sigmaswarm(*command)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "and 1 more argument are too many: " in ended.err and takes in ended.err, ended.err


def test_an_option_in_a_message_is_in_a_help(sigmaswarm: Command, here: Path):
    rows = [f"{i / 100},0,0,0,{i},0" for i in range(300)]
    (here / "log.csv").write_text("t,ax,ay,gz,x,y\n" + "\n".join(rows) + "\n")
    ended = sigmaswarm("import", "log.csv", "--out", "x", "--declination", "3")
    assert "with --mag-topic (`sigmaswarm import --help-all` describes --mag-topic)" in ended.err
    assert sigmaswarm("import", "log.csv", "--out", "x").code == 0
    ended = sigmaswarm("import", "log.csv", "--out", "x")
    assert "add --overwrite, or choose another folder, for example --out x-2\n" in ended.err
    assert "--overwrite" in sigmaswarm("import", "--help").out


def test_a_drive_is_not_written_into_a_drive(sigmaswarm: Command, here: Path):
    library.write_drive(library.simulate("urban", duration=40.0, imu_rate=50.0), here / "outer")
    for command in (("split", "outer", "--out", "outer"), ("doctor", "outer", "--fix", "outer/mended")):
        ended = sigmaswarm(*command)
        assert ended.code == 2 and f"is inside the drive {here / 'outer'}; specify a folder" in ended.err
    assert len(list((here / "outer").iterdir())) == 4


@pytest.mark.long
def test_the_next_command_follows_from_the_findings(sigmaswarm: Command, here: Path, doctored: None):
    """The IMU is upside down: no assumption about its axes, and no tuning, is proposed."""
    drive = library.simulate("urban", duration=60.0, imu_rate=50.0, gps="white-1m")
    imu = drive.imu
    down = [-values for values in (imu.ay, imu.az, imu.gy, imu.gz) if values is not None]
    over = replace(imu, **dict(zip(("ay", "az", "gy", "gz"), down, strict=True)))
    library.write_drive(replace(drive, imu=over, truth=None), here / "over")
    log = "import", "over/imu.csv", "--gps", "over/gps.csv", "--out"
    told = sigmaswarm(*log, "drive").out
    assert "[mounting]" in told and "assumed" not in told and "points down" not in told
    assert "next: sigmaswarm doctor drive --fix mended\n" in told
    told = sigmaswarm(*log, "right", "--mount", "auto").out
    assert (
        "was estimated from the log" in told
        and "assumed" not in told
        and "next: sigmaswarm split right" in told
    )
    told = sigmaswarm("split", "drive", "--out", "parts").out
    assert "next: sigmaswarm doctor drive --fix mended " in told
    quick = "--particles", "2", "--generations", "1", "--model", "planar5"
    told = sigmaswarm("tune", "drive", "--out", "t", *quick).out
    assert "next: sigmaswarm doctor drive --fix mended\n" in told and "evaluate" not in told
    told = sigmaswarm("evaluate", "t", "drive").out
    assert "next: sigmaswarm doctor drive --fix mended " in told


@pytest.mark.parametrize(
    "command", some(["tune {} --out q", "doctor {}", "evaluate {filter} {}", "split {} --out q"], 4)
)
def test_a_log_instead_of_a_drive_gives_the_import_command(
    sigmaswarm: Command, here: Path, tuned: Path, command: str
):
    """The input is a file, a folder of a log, or a folder with tables named as in a drive."""
    drive = library.simulate("urban", run=3, duration=40.0, imu_rate=50.0, gps="white-1m")
    Path("log").mkdir()
    pl.DataFrame({n: v for n, v in vars(drive.imu).items() if v is not None}).write_csv("log/imu.csv")
    pl.DataFrame({"time": drive.gps.time, "x": drive.gps.x, "y": drive.gps.y}).write_csv("log/gps.csv")
    write_mcap(here / "log.mcap", messages(simulated()))
    write_ros(here / "monday", messages(simulated()), "mcap")
    for log in ("log", "log.mcap", "monday"):
        said = sigmaswarm(*command.format(log, filter=tuned).split())
        (typed,) = re.findall(
            r"to make a drive from a log: sigmaswarm (import .*?)(?:;|$)", said.err, re.MULTILINE
        )
        assert said.code == 2
        assert sigmaswarm(*shlex.split(typed), "--overwrite").code == 0
        assert len(library.read_drive(shlex.split(typed)[-1]).gps) > 10


def test_a_file_instead_of_a_drive_gives_its_folder(sigmaswarm: Command, here: Path):
    """The input is a file of a drive or of a log with several files; a table with both sensors is a complete log."""
    drive = library.simulate("urban", run=3, duration=40.0, imu_rate=50.0, gps="white-1m")
    library.write_drive(drive, "drive")
    assert "; specify the folder drive\n" in sigmaswarm("doctor", "drive/imu.csv").err
    phone = {"time": drive.imu.time, **{i: getattr(drive.imu, f"a{i}") for i in "xy"}}
    place = {
        "time": drive.gps.time,
        "lat": drive.gps.y,
        "lon": drive.gps.x,
        "horizontalAccuracy": drive.gps.x,
    }
    both = {"t": drive.imu.time, "ax": drive.imu.ax, "ay": drive.imu.ay, "x": drive.imu.ax, "y": drive.imu.ay}
    Path("raw").mkdir()
    for name, columns in (("imu", phone), ("Location", place), ("monday", both)):
        pl.DataFrame(columns).write_csv(f"raw/{name}.csv")
    for file, log in (
        ("imu.csv", "raw"),
        ("Location.csv", "raw"),
        ("monday.csv", "raw/monday.csv"),
    ):
        said = sigmaswarm("tune", f"raw/{file}", "--out", "t").err
        assert f"sigmaswarm import {log} --out drives/{Path(log).stem}\n" in said
    said = sigmaswarm("tune", "raw", "--out", "t").err
    assert said.index("sigmaswarm import raw") < said.index(
        "if the tables in the folder have the columns of a drive, write"
    )


def test_what_the_diagnosis_of_an_import_states_is_printed_once(sigmaswarm: Command, here: Path):
    drive = library.simulate("urban", run=3, duration=40.0, imu_rate=50.0, gps="white-1m")
    kept = drive.imu.select(drive.imu.time < 18.0)
    pl.DataFrame({n: v for n, v in vars(kept).items() if v is not None}).write_csv("imu.csv")
    pl.DataFrame({"time": drive.gps.time, "x": drive.gps.x, "y": drive.gps.y}).write_csv("gps.csv")
    ended = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "drive")
    assert " ".join((ended.out + ended.err).split()).count("outside of the IMU's time span") == 1


@pytest.mark.parametrize("origin", some([(48.0, 11.0, 0.0), (-23.0, -46.0, 0.0), (37.0, -122.0, 0.0)], 3))
def test_exchanged_latitude_and_longitude_give_a_command_that_helps(
    sigmaswarm: Command, here: Path, origin: tuple[float, float, float]
):
    """From the import and from the doctor; a latitude beyond 90 degrees is refused."""
    drive = library.simulate("urban", run=3, duration=60.0, imu_rate=50.0, gps="white-1m")
    pl.DataFrame({n: v for n, v in vars(drive.imu).items() if v is not None}).write_csv("imu.csv")
    place = np.column_stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x])
    lat, lon, _ = enu_to_geodetic(place, origin).T
    pl.DataFrame({"time": drive.gps.time, "lat": lon, "lon": lat}).write_csv("gps.csv")
    first = sigmaswarm("import", "imu.csv", "--gps", "gps.csv", "--out", "drive")
    if abs(origin[1]) > 90:
        assert first.code == 2 and "exceeds 90: latitude and longitude are exchanged" in first.err
        options = shlex.split(re.search(r"write (--map .*)$", first.err, re.MULTILINE)[1])
        typed = [["import", "imu.csv", "--gps", "gps.csv", "--out", "drive", *options]]
    else:
        doctor = sigmaswarm("doctor", "drive").out
        lines = [
            re.search(r"^next: sigmaswarm (.*?)(?:    .*)?$", out, re.MULTILINE)[1]
            for out in (first.out, doctor)
        ]
        typed = [shlex.split(line) for line in lines]
        assert lines[1].startswith("import drive --out mended/drive --map gps.lat=lon")
    for words in reversed(typed):
        ended = sigmaswarm(*words)
        assert ended.code == 0 and "mirrored" not in ended.out
        got = library.read_drive(words[words.index("--out") + 1])
        np.testing.assert_allclose(got.gps.lat, lat, atol=1e-9)
