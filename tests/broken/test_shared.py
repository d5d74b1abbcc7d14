"""Inputs and failures that fuzzers found, in ../shared/broken outside the repository: one test for each.

``pytest tests/broken -m long``. Each input must give a drive, or one line and exit code 2, within 10 s of processor
time and with 1.5 GB of memory. The failures in ``faults/`` have a folder of input, or a script that this file repeats.
"""

import gzip
import json
import re
import shutil
import sqlite3
import time
from collections.abc import Callable
from math import pi
from pathlib import Path
from xml.dom import minidom

import numpy as np
import polars as pl
import pytest

import processes
from fuzzing.live import feed
from sigmaswarm import read_drive
from sigmaswarm.geodesy import enu_to_geodetic

SHARED = Path(__file__).resolve().parents[3] / "shared" / "broken"
INPUTS = sorted((SHARED / "inputs").glob("*/*"))
SECONDS, MEGABYTES = 10, 1500
PROGRAM = """
import json, resource
from sigmaswarm.cli import main
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    open("used.json", "w").write(json.dumps([used.ru_maxrss / 1000, used.ru_utime + used.ru_stime]))
"""

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::sigmaswarm.errors.SigmaswarmWarning"),
    pytest.mark.skipif(not INPUTS, reason="the folder ../shared/broken is not there"),
]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(*arguments: object) -> tuple[int, str]:
    """Run a command within the limits: its exit code and what it wrote.

    Raises
    ------
    AssertionError
        It crashed, took too long or too much, or an error is not one line.
    """
    process = processes.Process(PROGRAM, arguments)
    end = time.monotonic() + 60
    while (code := process.poll()) is None and time.monotonic() < end:
        time.sleep(0.01)
    if code is None:
        process.kill()
        pytest.fail(f"{arguments[0]} still runs after 60 s")
    out, err = process.communicate()
    process.wait()
    assert code in (0, 2), f"exit code {code}: {err[-300:]}"
    assert "Traceback" not in err
    assert "DLASCL" not in out + err
    assert "RuntimeWarning" not in err
    if code == 2:
        assert len(re.findall("^sigmaswarm: ", err, re.MULTILINE)) == 1, err[-500:]
        megabytes, seconds = json.loads(Path("used.json").read_text())
        assert megabytes < MEGABYTES, f"{megabytes:.0f} MB"
        assert seconds < SECONDS, f"{seconds:.1f} s"
    return code, out + err


def refused(*arguments: object, names: str = "") -> str:
    code, said = command(*arguments)
    assert code == 2, f"accepted: {said[-300:]}"
    assert names in said, said[-300:]
    return said


def log_of(folder: Path, reader: str) -> Path:
    """The path of a reader's log in the folder of an input."""
    below = {"csvfolder": "d", "drive_enu": "d", "drive_wgs": "d", "sl_android": "export", "sl_ios": "export"}
    if reader in below:
        return folder / below[reader]
    if reader == "phyphox":
        return folder / "export"
    if reader in ("nclt", "comma"):
        return folder
    if reader == "kitti":
        return next((x for x in folder.iterdir() if x.is_dir()), folder)
    return next((f for f in folder.rglob("*") if f.is_file()), folder / "gone")


@pytest.mark.parametrize("folder", INPUTS, ids=lambda f: f"{f.parent.name}-{f.name}")
def test_an_input_gives_a_drive_or_one_line(folder: Path, base: Path):
    reader = folder.parent.name
    shutil.copytree(folder / "in", "in", symlinks=True)
    path = log_of(Path("in"), reader)
    if reader.startswith("drive"):
        command("doctor", path)
        return
    form = re.findall(r"^format=(.+)$", (folder / "why.txt").read_text(), re.MULTILINE)
    asked = ["--format", form[0]] if form and form[0] != "None" else []
    if reader in ("ubx", "nmea") or reader.startswith("rtklib"):
        asked = ["--gps", path]
        path = base / "imu.csv"
    code, _ = command("import", path, *asked, "--out", "out")
    if code == 0:
        read_drive("out")


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a sound drive."""
    out = tmp_path_factory.mktemp("base")
    what = [
        "--maneuver",
        "urban",
        "--environment",
        "clear",
        "--runs",
        "1",
        "--gps",
        "white-1m",
        "--duration",
        60,
    ]
    made = processes.run(processes.COMMAND, "simulate", "--out", out, *what)
    assert made.returncode == 0, made.stderr
    return out / "urban-clear-00"


def copied(base: Path, to: str = "d") -> Path:
    return Path(shutil.copytree(base, to))


def changed(file: Path, change: Callable[[pl.DataFrame], pl.DataFrame]) -> None:
    change(pl.read_csv(file)).write_csv(file)


def fault(name: str) -> Path:
    return SHARED / "faults" / name


def tuning(name: str = "15-tuning-toml-crashes") -> Path:
    return fault(name) / "tuning.toml"


@pytest.mark.parametrize("column", ["yaw_deg", "theta [deg]", "yaw (°)"])
def test_01_truth_in_degrees(column: str, base: Path):
    log = copied(base, "log")
    changed(
        log / "truth.csv", lambda t: t.with_columns((pl.col("theta") * 180 / pi).alias(column)).drop("theta")
    )
    (log / "drive.toml").unlink()
    if command("import", "log", "--format", "csv", "--out", "out")[0] == 0:
        assert pl.read_csv("out/truth.csv")["theta"].abs().max() < 7.0


def test_02_first_fix_at_zero(base: Path):
    gps = pl.read_csv(base / "gps.csv")
    places = enu_to_geodetic(np.column_stack([gps["x"], gps["y"], 0 * gps["x"]]), (51.0, 13.8, 0.0))
    places[0, :2] = 0
    Path("log").mkdir()
    shutil.copy(base / "imu.csv", "log")
    pl.DataFrame({"t": gps["t"], "lat": places[:, 0], "lon": places[:, 1]}).write_csv("log/gps.csv")
    code, said = command("import", "log", "--format", "csv", "--out", "out")
    if code == 0:
        drive = read_drive("out")
        driven = np.hypot(np.diff(gps["x"][1:]), np.diff(gps["y"][1:])).sum()
        found = np.hypot(np.diff(drive.gps.x[1:]), np.diff(drive.gps.y[1:])).sum()
        assert abs(found - driven) < 0.05 * driven or "0, 0" in said or "origin" in said


def test_03_a_full_disk_leaves_the_old_evaluation(base: Path, here: Path):
    room = Path("/dev/shm")
    if not room.is_dir():
        pytest.skip("needs a second file system")
    folder = fault("03-full-disk-leaves-a-mixed-evaluation")
    command("evaluate", folder / "tuning-planar8.toml", base, "--out", "e")
    before = {f.name: f.read_bytes() for f in Path("e").iterdir()}
    for largest in (20_000, 100_000, 400_000):  # a file that grows beyond it is refused, as on a full disk
        ended = processes.run(
            processes.COMMAND,
            "evaluate",
            folder / "tuning-planar5.toml",
            base,
            "--out",
            "e",
            "--overwrite",
            largest_file=largest,
        )
        if ended.returncode == 0:
            break
        assert ended.returncode == 2, ended.stderr[-300:]
        assert {f.name: f.read_bytes() for f in Path("e").iterdir()} == before


def test_03_report_refuses_files_that_do_not_belong_together(base: Path):
    folder = fault("03-full-disk-leaves-a-mixed-evaluation")
    for model in ("5", "8"):
        command("evaluate", folder / f"tuning-planar{model}.toml", base, "--out", f"e{model}")
    for name in ("scores.csv", "scores.json"):
        shutil.copy(f"e5/{name}", "e8")
    refused("report", "e8", "--out", "page.html", names="e8")


def test_04_a_gzip_bomb_named_csv(base: Path):
    with gzip.open("bomb.csv", "wb", 1) as file:
        file.write(b"t,ax,ay,gz\n")
        for _ in range(20000):
            file.write(b"1.0,1.0,1.0,1.0\n" * 4096)
    refused("import", "bomb.csv", "--show", names="bomb.csv")
    for name in ("imu", "gps", "truth"):
        drive = copied(base, name)
        shutil.copy("bomb.csv", drive / f"{name}.csv")
        refused("doctor", drive, names=f"{name}.csv")


@pytest.mark.parametrize("form", ["nmea", "rtklib", "gnss-logger", "csv", "tuning"])
def test_06_an_endless_line(form: str, base: Path):
    with Path("zero.bin").open("wb") as file:
        file.truncate(40 << 30)  # a sparse file
    if form == "tuning":
        refused("run", "zero.bin", base, "--out", "e.csv", names="zero.bin")
    else:
        refused("import", "zero.bin", "--format", form, "--show", names="zero.bin")


UNITS = {
    "x [km],y [km]": ("gps", 1e-3),
    "east (ft),north (ft)": ("gps", 1 / 0.3048),
    "gz [rpm]": ("imu", 60 / 2 / pi),
    "gyro_z [mdps]": ("imu", 180000 / pi),
    "gz (mrad/s)": ("imu", 1e3),
    "time [min]": ("both", 1 / 60),
    "time [h]": ("both", 1 / 3600),
}


@pytest.mark.parametrize("names", UNITS)
def test_07_units_in_names(names: str, base: Path):
    table, factor = UNITS[names]
    old = ["x", "y"] if "," in names else ["t"] if "time" in names else ["gz"]
    renamed = dict(zip(old, names.split(","), strict=True))
    Path("log").mkdir()
    for name in ("imu", "gps"):
        frame = pl.read_csv(base / f"{name}.csv")
        if table in (name, "both"):
            frame = frame.with_columns(pl.col(old) * factor).rename(renamed)
        frame.write_csv(f"log/{name}.csv")
    code, said = command("import", "log", "--format", "csv", "--out", "out")
    if code == 0:
        got, sound = read_drive("out"), read_drive(base)
        right = np.allclose(np.ptp(got.gps.x), np.ptp(sound.gps.x), rtol=0.01)
        right &= np.allclose(got.imu.gz, sound.imu.gz, atol=1e-6) and np.isclose(got.duration, sound.duration)
        assert right or re.search(r"unit .* (unknown|not known)", said), (
            "accepted with a unit that is passed over"
        )


def test_08_a_damaged_ulog():
    refused("import", fault("08-ulog-hangs") / "hangs.ulg", "--show", names="hangs.ulg")


def test_09_a_long_header():
    rows = "\n".join(f"{i / 100},0,0,0,50,8,1" for i in range(300))
    Path("log.csv").write_text("t,ax,ay,gz,lat,lon,a" + " " * 130000 + "b\n" + rows)
    command("import", "log.csv", "--show")
    assert json.loads(Path("used.json").read_text())[1] < SECONDS


@pytest.mark.parametrize("cell", ["ax=1e308", "ay=1e155", "gz=1e200", "gx=1e308", "ax=1e16"])
def test_11_one_huge_cell(cell: str, base: Path):
    column, value = cell.split("=")
    drive = copied(base)
    at = pl.int_range(pl.len()) == 50
    changed(
        drive / "imu.csv",
        lambda t: t.with_columns(pl.when(at).then(float(value)).otherwise(pl.col(column)).alias(column)),
    )
    for arguments in (("doctor", drive), ("run", tuning(), drive, "--out", "e.csv")):
        said = refused(*arguments, names="imu.csv")
        assert "row 52" in said
        assert f"column {column}" in said
    refused("import", base, "--format", "csv", "--out", "m", "--map", "ax=exp(exp(exp(exp(ax))))")


@pytest.mark.parametrize("part", range(6))
def test_12_and_20_live_filters(part: int):
    for k in range(5):
        feed(np.random.default_rng([46, part, k]), bank=k == 0, events=400)


def test_13_text_for_a_time():
    shutil.copytree(fault("13-ros2-text-timestamps") / "bag", "bag")
    Path("bag").chmod(0o755)
    Path("bag/bag.db3").chmod(0o644)
    with sqlite3.connect("bag/bag.db3") as base:
        base.execute("update messages set timestamp='abc' where rowid=7")
    base.close()
    command("import", "bag", "--out", "d")


@pytest.mark.parametrize("how", ["digits", "nested", "config"])
def test_15_a_tuning_that_is_no_sound_toml(how: str, base: Path):
    text = tuning().read_text()
    first = {
        "digits": "x = " + "9" * 5000,
        "nested": "x = " + "[" * 3000 + "]" * 3000,
        "config": "config = 3",
    }
    if how == "config":
        text = re.sub(r"\[config\].*?(?=\[versions\])", "", text, flags=re.DOTALL)
    Path("t.toml").write_text(f"{first[how]}\n{text}")
    shutil.copy("t.toml", "tuning.toml")
    refused("run", "t.toml", base, "--out", "e.csv", names="t.toml")
    if how != "config":
        refused("export", "t.toml", "--to", "c99", "--out", "c", names="t.toml")
    refused("report", ".", names="tuning.toml")


def test_15_scores_that_are_nested():
    Path("ev").mkdir()
    Path("ev/evaluation.json").write_text("{}")
    shutil.copy(tuning(), "ev")
    Path("ev/scores.json").write_text("[" * 100_000)
    refused("report", "ev", names="ev/")


def history_without_best(path: Path) -> None:
    arrays = dict(np.load(path))
    del arrays["best"]
    np.savez(path, **arrays)


def more_keys(path: Path) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), "zzz": 1}))


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("result.json", lambda path: path.write_text('"x"')),
        ("result.json", more_keys),
        ("result.json", lambda path: path.write_text("[" * 100_000)),
        ("history.npz", history_without_best),
        ("history.npz", lambda path: path.write_bytes(b"PK")),
    ],
)
def test_16_damaged_records(file: str, damage: Callable[[Path], object], base: Path):
    arguments = ("tune", base, "--out", "t", "--particles", 3, "--generations", 2, "--model", "planar5")
    command(*arguments)
    damage(Path("t/trial-000") / file)
    refused(*arguments, "--resume", names=f"trial-000/{file}")


@pytest.mark.parametrize("form", ["gpx", "kml"])
@pytest.mark.parametrize("name", ["a]]>b", "a\\u0001b", "<&>\\u0000", "\\u001b[31m", "\\uFFFEx"])
def test_17_names_in_maps(form: str, name: str, base: Path):
    drive = copied(base)
    kept = [line for line in (drive / "drive.toml").read_text().splitlines() if not line.startswith("name")]
    (drive / "drive.toml").write_text("\n".join([f'name = "{name}"', *kept]))
    code, _ = command("run", tuning(), drive, "--out", f"e.{form}", "--origin", "49,8")
    if code == 0:
        minidom.parse(f"e.{form}")


def test_19_messages_name_the_file():
    Path("e").mkdir()
    for name, head, row in (
        *((f, "time,seconds_elapsed,x,y,z", "0,0,0,9.8") for f in ("Accelerometer", "Gravity", "Gyroscope")),
        ("Location", "time,latitude,longitude,altitude,horizontalAccuracy,speed,bearing", "50,8,0,1,1,1"),
    ):
        rows = [f"17000000{i}000000000,{row}" for i in range(10, 61)]
        Path(f"e/{name}.csv").write_text(
            "\n".join([head.replace("time", "Time") if "Gy" in name else head, *rows])
        )
    Path("e/Metadata.csv").write_text("version\n")
    refused("import", "e", "--out", "d", names="Gyroscope")
    rows = [f"0.{i},0,0,9.8,0,50,8" for i in range(10, 61)]
    Path("log.csv").write_text("\n".join(["t,`acc_x`,acc_y,acc_z,gyro_z,lat,lon", *rows]))
    code, said = command("import", "log.csv", "--out", "d")
    assert code == 0 or "log.csv" in said
