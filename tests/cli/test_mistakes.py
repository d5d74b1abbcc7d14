"""Every mistake gives exit code 2 and one line that names the place. `pytest -s` prints the table."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import sigmaswarm as library
from support import make_drive

Edit = Callable[[Path], object]


def cell(file: str, row: int, column: str, value: str) -> Edit:
    """Write a value into line ``row`` of the file, counted as in an editor."""

    def edit(folder: Path) -> None:
        table = [line.split(",") for line in (folder / file).read_text().splitlines()]
        table[row - 1][table[0].index(column)] = value
        (folder / file).write_text("".join(",".join(r) + "\n" for r in table))

    return edit


def renamed(file: str, column: str, name: str) -> Edit:
    def edit(folder: Path) -> None:
        header, rest = (folder / file).read_text().split("\n", 1)
        columns = [name if c == column else c for c in header.split(",")]
        (folder / file).write_text(",".join(columns) + "\n" + rest)

    return edit


def first_rows(file: str, count: int) -> Edit:
    def edit(folder: Path) -> None:
        (folder / file).write_text("\n".join((folder / file).read_text().splitlines()[: count + 1]))

    return edit


def degrees(latitude: str) -> Edit:
    def edit(folder: Path) -> None:
        times = [line.split(",")[0] for line in (folder / "gps.csv").read_text().splitlines()[1:]]
        lines = ["t,lat,lon", *(f"{t},{latitude if i == 3 else '50.1'},13.7" for i, t in enumerate(times))]
        (folder / "gps.csv").write_text("\n".join(lines))
        (folder / "drive.toml").write_text('frame = "wgs84"')

    return edit


def later(seconds: float) -> Edit:
    def edit(folder: Path) -> None:
        header, *rows = (folder / "gps.csv").read_text().splitlines()
        moved = [f"{float(t) + seconds},{rest}" for t, rest in (r.split(",", 1) for r in rows)]
        (folder / "gps.csv").write_text("\n".join([header, *moved]))

    return edit


def standing(folder: Path) -> None:
    header, *rows = (folder / "gps.csv").read_text().splitlines()
    (folder / "gps.csv").write_text("\n".join([header, *(f"{r.split(',')[0]},1.0,2.0" for r in rows)]))


# change of the good drive, and the expected parts of the line
DRIVES: dict[str, tuple[Edit, list[str]]] = {
    "missing-folder": (shutil.rmtree, ["bad", "does not exist", "folder"]),
    "missing-imu": (lambda f: (f / "imu.csv").unlink(), ["bad/imu.csv", "missing"]),
    "missing-gps": (lambda f: (f / "gps.csv").unlink(), ["bad/gps.csv", "missing"]),
    "missing-toml": (lambda f: (f / "drive.toml").unlink(), ["bad/drive.toml", "missing", "frame"]),
    "missing-column": (renamed("imu.csv", "gz", "yaw"), ["bad/imu.csv", "row 1", "gz", "add it, or rename"]),
    "missing-truth-column": (renamed("truth.csv", "vx", "u"), ["bad/truth.csv", "row 1", "vx"]),
    "not-a-number": (cell("imu.csv", 17, "ax", "fast"), ["bad/imu.csv", "row 17", "ax", "'fast'", "delete"]),
    "nan": (cell("gps.csv", 8, "y", "nan"), ["bad/gps.csv", "row 8", "y", "'nan'", "delete"]),
    "time-not-increasing": (cell("imu.csv", 30, "t", "0.1"), ["bad/imu.csv", "row 30", "t", "'0.1'", "sort"]),
    "latitude-out-of-range": (degrees("91.5"), ["bad/gps.csv", "row 5", "lat", "'91.5'", "-90 to 90"]),
    "no-overlap": (later(1e4), ["bad/", "imu.csv", "gps.csv", "overlap", "clock"]),
    "too-few-fixes": (first_rows("gps.csv", 5), ["bad/gps.csv", "5 fixes", "too few", "at least"]),
    "too-few-samples": (first_rows("imu.csv", 50), ["bad/", "too few"]),
    "ragged-row": (cell("imu.csv", 12, "ax", "1,5"), ["bad/imu.csv", "row 12", "cells"]),
    "no-csv": (lambda f: (f / "imu.csv").write_bytes(b"\x00\xff\xfe\x01" * 40), ["bad/imu.csv"]),
    "broken-toml": (lambda f: (f / "drive.toml").write_text("name = "), ["bad/drive.toml", "TOML"]),
    "never-moves": (standing, ["synthetic: ", "20 m", "heading"]),
}


def checked(ended, expected: list[str], case: str) -> None:
    """Check exit code 2, no stdout, and one line on stderr with all expected parts."""
    print(f"\n{case:>28} | {ended.err.strip()}")
    assert ended.code == 2
    assert ended.out == ""
    assert ended.err.startswith("sigmaswarm: ")
    assert ended.err.count("\n") == 1
    assert ended.err.endswith("\n")
    assert "Traceback" not in ended.err
    assert "errors.pydantic.dev" not in ended.err
    assert [part for part in expected if part not in ended.err] == []


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library.write_drive(make_drive(duration=20.0), tmp_path_factory.mktemp("good") / "good")


@pytest.mark.parametrize("case", DRIVES)
def test_a_bad_drive(sigmaswarm, good: Path, here: Path, case: str):
    edit, expected = DRIVES[case]
    edit(shutil.copytree(good, "bad") and Path("bad"))
    checked(sigmaswarm("tune", "bad", "--out", "t"), expected, case)
    assert not Path("t").exists()


@pytest.mark.parametrize("command", ["evaluate", "run", "split", "plot"])
def test_a_bad_drive_in_other_commands(sigmaswarm, good: Path, tuned: Path, here: Path, command: str):
    edit, expected = DRIVES["not-a-number"]
    edit(shutil.copytree(good, "bad") and Path("bad"))
    arguments = {
        "evaluate": [tuned, "bad"],
        "run": [tuned, "bad", "--out", "x.csv"],
        "split": ["bad", "--out", "parts"],
        "plot": ["bad"],
    }
    checked(sigmaswarm(command, *arguments[command]), expected, command)
    assert {p.name for p in here.iterdir()} == {"bad"}


def blind(folder: Path) -> None:
    (folder / "good" / "truth.csv").unlink()


def nothing(folder: Path) -> None:
    pass


def results(folder: Path) -> None:
    library.tune(library.read_drive(folder / "good"), out=folder / "t", particles=2, generations=1)


def file(name: str, content: str = "") -> Edit:
    return lambda folder: (folder / name).write_text(content)


def folder(name: str) -> Edit:
    return lambda parent: (parent / name / "within").mkdir(parents=True)


# preparation of the folder with good/ and tuning.toml, command, and expected parts of the line
OPTIONS: dict[str, tuple[Edit, str, list[str]]] = {
    "unknown-command": (nothing, "tone good", ["tone", "tune"]),
    "unknown-option": (nothing, "tune good --out t --partikles 3", ["--partikles"]),
    "no-drive": (nothing, "tune --out t", ["DRIVE"]),
    "no-out": (nothing, "tune good", ["--out is missing: specify a folder for the result"]),
    "misspelt-out": (nothing, "tune good --ouy t", ["--out", "Did you mean"]),
    "empty-out": (nothing, "tune good --out", ["--out", "requires an argument"]),
    "folder-without-drives": (
        folder("empty"),
        "tune empty --out t",
        ["empty", "contains no drive", "imu.csv"],
    ),
    "unknown-objective": (
        nothing,
        "tune good --out t --objective rmse",
        ["'rmse'", "truth-rmse", "gps-rmse"],
    ),
    "no-validation-drive": (nothing, "tune good --out t --validation", ["--validation", "at least 1"]),
    "nothing-to-use": (nothing, "tune good --out t --use", ["--use", "at least 1"]),
    "unknown-scale": (nothing, "tune good --out t --scale cubic", ["cubic", "--scale", "log10"]),
    "unknown-model": (nothing, "tune good --out t --model planar9", ["planar9", "--model", "planar5"]),
    "negative-particles": (nothing, "tune good --out t --particles -3", ["particles", "-3", "2"]),
    "one-particle": (nothing, "tune good --out t --particles 1", ["particles", "1", "2"]),
    "particles-no-number": (nothing, "tune good --out t --particles many", ["--particles", "many"]),
    "no-generations": (nothing, "tune good --out t --generations 0", ["generations", "0", "1"]),
    "no-trials": (nothing, "tune good --out t --trials 0", ["trials", "0", "1"]),
    "negative-seed": (nothing, "tune good --out t --seed -1", ["seed", "-1"]),
    "no-patience": (nothing, "tune good --out t --patience 0", ["patience", "0"]),
    "inertia-nan": (nothing, "tune good --out t --inertia nan", ["inertia", "nan"]),
    "no-workers": (nothing, "tune good --out t --workers 0", ["workers", "0"]),
    "no-truth": (
        blind,
        "tune good --out t --objective truth-rmse",
        ["synthetic: ", "no truth", "truth-rmse", "innovation-nll"],
    ),
    "no-truth-pose": (
        blind,
        "tune good --out t --objective truth-pose",
        ["no truth", "truth-pose", "innovation-nll"],
    ),
    "out-exists": (
        results,
        "tune good --out t --particles 2 --generations 1",
        ["t: already contains a tuning; choose another folder, for example --out t-2, or add --resume"],
    ),
    "out-exists-first": (results, "tune nowhere --out t", ["t: already contains a tuning"]),
    "out-of-another": (
        results,
        "tune good --out t --particles 3 --generations 1 --resume",
        ["t/config.json", "particles = 2", "particles = 3"],
    ),
    "out-is-a-file": (file("t"), "tune good --out t", ["t:", "folder", "--out"]),
    "out-below-a-file": (file("f"), "tune good --out f/t", ["f/t", "folder", "--out"]),
    "paper-and-scale": (
        nothing,
        "tune good --out t --paper --scale log10",
        ["scale", "'log10'", "paper's setting", "linear", "omit"],
    ),
    "paper-and-racing": (nothing, "tune good --out t --paper --racing", ["racing", "paper's setting"]),
    "compare-unknown-optimizer": (
        nothing,
        "compare good --out c --optimizers pso ants",
        ["'ants'", "pso", "cma-es"],
    ),
    "compare-two-budgets": (
        nothing,
        "compare good --out c --optimizers pso pso:particles=60",
        ["pso:particles=60", "3000", "1500", "the same"],
    ),
    "compare-unknown-setting": (
        nothing,
        "compare good --out c --optimizers pso:wings=2",
        ["wings=2", "NAME=VALUE", "polish"],
    ),
    "compare-unknown-scale": (nothing, "compare good --out c --scales cubic", ["cubic", "log10"]),
    "compare-no-seeds": (nothing, "compare good --out c --seeds 0", ["seeds = 0"]),
    "compare-no-workers": (nothing, "compare good --out c --workers 0", ["workers", "0"]),
    "compare-no-out": (nothing, "compare good", ["--out is missing: specify a folder for the result"]),
    "compare-no-validation-drive": (
        nothing,
        "compare good --out c --validation nowhere",
        ["nowhere", "does not exist"],
    ),
    "compare-out-is-a-file": (file("c"), "compare good --out c", ["c:", "folder", "--out"]),
    "no-tuning": (nothing, "evaluate nowhere good", ["nowhere", "no such file"]),
    "evaluate-swapped": (
        nothing,
        "evaluate good tuning.toml",
        ["good: is a drive", "as in sigmaswarm evaluate TUNING good"],
    ),
    "evaluate-into-a-drive": (
        nothing,
        "evaluate tuning.toml good --out good/e",
        ["good/e: is in the drive ", "choose an --out outside of this folder"],
    ),
    "export-into-a-drive": (
        nothing,
        "export tuning.toml --to c99 --out good",
        ["good: is a drive; choose an --out outside of this folder"],
    ),
    "export-a-drive": (
        nothing,
        "export good --to filterpy --out py",
        [
            "good: is a drive",
            "sigmaswarm tune good --out tuned, then sigmaswarm export tuned --to filterpy --out py",
        ],
    ),
    "learn-a-drive": (
        nothing,
        "learn outage-lstm good good --out l",
        ["good: is a drive", "as in sigmaswarm learn outage-lstm TUNING good"],
    ),
    "run-swapped": (
        nothing,
        "run good tuning.toml --out x.csv",
        ["good: is a drive", "as in sigmaswarm run TUNING good"],
    ),
    "tuning-without-filter": (file("p.toml", "a = 1"), "evaluate p.toml good", ["p.toml", "[filter]"]),
    "tuning-broken": (file("p.toml", "a ="), "evaluate p.toml good", ["p.toml", "not readable"]),
    "evaluate-no-drive": (nothing, "evaluate tuning.toml", ["DRIVE"]),
    "evaluate-out-is-a-file": (file("e"), "evaluate tuning.toml good --out e", ["e:", "folder", "--out"]),
    "outage-length-zero": (nothing, "evaluate tuning.toml good --outage-length 0", ["--outage-length", "0"]),
    "outage-length-infinite": (
        nothing,
        "evaluate tuning.toml good --outage-length inf",
        ["outage-length", "inf"],
    ),
    "outage-seed-negative": (nothing, "evaluate tuning.toml good --outage-seed -1", ["outage-seed", "-1"]),
    "run-unknown-suffix": (nothing, "run tuning.toml good --out x.xls", ["x.xls", ".csv", ".tum"]),
    "run-no-suffix": (nothing, "run tuning.toml good --out x", ["x:", ".csv", ".tum"]),
    "run-no-such-folder": (nothing, "run tuning.toml good --out no/x.csv", ["no", "no such folder"]),
    "run-out-is-a-folder": (folder("x.csv"), "run tuning.toml good --out x.csv", ["x.csv", "folder"]),
    "run-no-out": (nothing, "run tuning.toml good", ["--out is missing: specify a file for the result"]),
    "run-log": (
        folder("raw"),
        "run tuning.toml raw --out x.csv",
        ["raw: contains no drive; a drive is a folder with imu.csv, ", "; to make a drive from a log: "],
    ),
    "run-two-drives": (nothing, "run tuning.toml good good --out x.csv", ["good"]),
    "run-negative-variance": (
        file(
            "p.toml",
            "[filter]\nalpha=0.1\nbeta=2\nkappa=0\nprocess_noise=[1,1,1,-1,1]\nmeasurement_noise=[1,1]",
        ),
        "run p.toml good --out x.csv",
        ["p.toml", "process_noise[3]", "-1", "negative"],
    ),
    "simulate-no-out": (nothing, "simulate", ["--out is missing: specify a folder"]),
    "simulate-no-runs": (nothing, "simulate --out s --runs 0", ["--runs"]),
    "simulate-negative-runs": (nothing, "simulate --out s --runs -2", ["--runs", "-2"]),
    "simulate-unknown-maneuver": (
        nothing,
        "simulate --out s --maneuver brake drift",
        ["'drift'", "cruise", "urban"],
    ),
    "simulate-unknown-environment": (
        nothing,
        "simulate --out s --environment rain hail",
        ["'hail'", "clear", "slippery"],
    ),
    "simulate-unknown-imu": (nothing, "simulate --out s --imu golden", ["IMU", "'golden'", "icm-20602"]),
    "simulate-unknown-gps": (nothing, "simulate --out s --gps golden", ["GPS", "'golden'", "ublox-m8"]),
    "simulate-unknown-vehicle": (nothing, "simulate --out s --vehicle trabant", ["'trabant'", "model3"]),
    "simulate-too-short": (
        nothing,
        "simulate --out s --maneuver brake urban --duration 3",
        ["duration", "30 s"],
    ),
    "simulate-endless": (nothing, "simulate --out s --maneuver urban --duration inf", ["duration", "30 s"]),
    "simulate-duration-of-nothing": (nothing, "simulate --out s --duration 60", ["duration", "'urban'"]),
    "simulate-no-workers": (nothing, "simulate --out s --workers 0", ["workers", "0"]),
    "simulate-negative-seed": (nothing, "simulate --out s --seed -1", ["seed", "-1"]),
    "simulate-out-is-a-file": (file("s"), "simulate --out s", ["s", "is a file", "folder"]),
    "simulate-out-below-a-file": (file("f"), "simulate --out f/s", ["f/s", "f is a file", "folder"]),
    "simulate-twice": (
        folder("s/cruise-clear-00"),
        "simulate --out s",
        ["s:", "cruise-clear-00", "--resume"],
    ),
    "simulate-beside-others": (nothing, "simulate --out .", [".:", "good", "--resume"]),
    "simulate-resume-something-else": (
        folder("s/cruise-clear-00"),
        "simulate --out s --resume",
        ["s/cruise-clear-00", "not a drive that simulate wrote"],
    ),
    "report-no-folder": (nothing, "report", ["FOLDER"]),
    "report-nowhere": (nothing, "report nowhere", ["nowhere", "no such folder", "evaluate"]),
    "report-of-a-drive": (nothing, "report good", ["good", "contains no results", "evaluate"]),
    "report-of-a-file": (nothing, "report good/imu.csv --out x.html", ["good/imu.csv", "is a file"]),
    "report-unknown-suffix": (nothing, "report t --out x.pdf", ["x.pdf", ".html"]),
    "report-no-such-folder": (nothing, "report t --out no/x.html", ["no:", "create it first"]),
    "report-out-is-a-folder": (folder("x.html"), "report t --out x.html", ["x.html", "folder"]),
    "plot-no-drive": (nothing, "plot", ["DRIVE"]),
    "plot-nowhere": (nothing, "plot nowhere", ["nowhere", "does not exist"]),
    "plot-unknown-suffix": (nothing, "plot good --out x.xls", ["x.xls", ".png"]),
    "plot-no-such-folder": (nothing, "plot good --out no/x.png", ["no", "no such folder"]),
    "plot-out-is-a-folder": (folder("x.png"), "plot good --out x.png", ["x.png", "folder"]),
    "plot-in-the-way": (folder("synthetic.png"), "plot good", ["synthetic.png", "folder"]),
    "split-nothing-left": (
        nothing,
        "split good --out parts --train-fraction 1.5",
        ["1.5", "between 0 and 1"],
    ),
    "split-twice": (
        nothing,
        "split good --out parts --train-fraction 0.5 --at 9",
        ["--at", "--train-fraction", "not both"],
    ),
    "split-elsewhere": (
        nothing,
        "split good --out parts --at 1e6",
        ["fewer than two IMU samples", "t = 0 to"],
    ),
    "split-out-is-a-file": (file("parts"), "split good --out parts", ["parts", "folder"]),
    "demo-elsewhere": (folder("d"), "demo --out d", ["d:", "not empty", "--out"]),
    "demo-out-is-a-file": (file("d"), "demo --out d", ["d", "--out"]),
    "demo-negative-seed": (nothing, "demo --out d --seed -1", ["seed", "-1"]),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_a_wrong_option(sigmaswarm, good: Path, tuned: Path, here: Path, case: str):
    prepare, command, expected = OPTIONS[case]
    shutil.copytree(good, "good")
    shutil.copy(tuned, "tuning.toml")
    prepare(here)
    before = {p: p.is_file() and p.stat().st_mtime_ns for p in here.rglob("*")}
    checked(sigmaswarm(*command.split()), expected, f"{case}: {command}")
    # No file is created or changed. Folders are not compared: a temporary lock changes their time.
    assert {p: p.is_file() and p.stat().st_mtime_ns for p in here.rglob("*")} == before


def test_a_failing_filter_writes_nothing(sigmaswarm, good: Path, tuned: Path, here: Path, monkeypatch):
    """A variance of 1e308 makes the filter fail."""
    text = tuned.read_text().replace("0.001", "1e308")
    Path("huge.toml").write_text(text)
    ended = sigmaswarm("run", "huge.toml", good, "--out", "x.csv")
    checked(ended, ["filter failed at t ="], "filter fails")
    assert not Path("x.csv").exists()


def test_a_command_can_be_repeated_after_a_mistake(sigmaswarm, good: Path, here: Path):
    """A failed command leaves no files that prevent the next run."""
    standing(shutil.copytree(good, "bad") and Path("bad"))
    assert sigmaswarm("tune", "bad", "--out", "t").code == 2
    ended = sigmaswarm("tune", good, "--out", "t", "--particles", 2, "--generations", 1)
    assert ended.code == 0, ended.err


def test_warnings_are_one_line_each(sigmaswarm, good: Path, tuned: Path, here: Path):
    renamed("imu.csv", "gy", "temperature")(shutil.copytree(good, "odd") and Path("odd"))
    ended = sigmaswarm("evaluate", tuned, "odd", "--json")
    assert ended.code == 0
    assert ended.err.startswith("warning: odd/imu.csv: ignoring 'temperature'")
    assert ended.err.count("\n") == 1
