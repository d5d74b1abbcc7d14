"""`sigmaswarm noise`: table, figure and files, and one line for a log without measurable noise."""

import json
import tomllib
from pathlib import Path

import polars as pl
import pytest
import yaml

from cli.conftest import Command
from static_logs import static_log


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write one minute at rest as a table of t, ax, ay, gz."""
    path = tmp_path_factory.mktemp("static") / "rest.csv"
    imu = static_log("mpu-6050", 60.0, 0.05)
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(path)
    return path


def test_a_table_without_fixes(sigmaswarm, log: Path, here: Path):
    ended = sigmaswarm("noise", log, "--to", "kf-gins", "sigmaswarm")
    assert ended.code == 0
    for expected in (
        "velocity random walk",
        "deg/sqrt(h)",
        "mGal",
        "note: the longest stretch at rest lasts 60 s",
        "imunoise:",
    ):
        assert expected in ended.out
    assert not list(here.iterdir())


def test_files(sigmaswarm, painted, log: Path, here: Path):
    ended = sigmaswarm("noise", log, "--to", "kalibr", "--out", "noise", "--json")
    found = json.loads(ended.out)
    assert {Path(p).name for p in found["written"]} == {"imu.yaml", "noise.json", "noise.png", "noise.svg"}
    assert all(Path(p).stat().st_size > 300 for p in found["written"])
    kept = json.loads(Path("noise/noise.json").read_text())
    assert kept["axes"] == found["axes"]
    axis = kept["axes"]["ax"]
    assert axis["white"]["low"] < axis["white"]["value"] < axis["white"]["high"]
    assert yaml.safe_load(Path("noise/imu.yaml").read_text())["update_rate"] == pytest.approx(20.0)


def test_a_folder_with_imu_csv_alone_and_renamed_columns(sigmaswarm, log: Path, here: Path):
    table = pl.read_csv(log)
    Path("rest").mkdir()
    table.write_csv("rest/imu.csv")
    direct = json.loads(sigmaswarm("noise", log, "--json").out)["axes"]
    assert json.loads(sigmaswarm("noise", "rest", "--json").out)["axes"] == direct
    table.rename({"gz": "spin"}).write_csv("odd.csv")
    mapped = json.loads(sigmaswarm("noise", "odd.csv", "--map", "ax=ax", "ay=ay", "gz=spin", "--json").out)[
        "axes"
    ]
    assert mapped == direct


def test_a_tuning(sigmaswarm, tuned: Path, here: Path):
    ended = sigmaswarm("noise", "--tuned", tuned, "--to", "sigmaswarm", "--out", "noise")
    assert ended.code == 0
    assert "m/s/sqrt(h)" in ended.out
    table, _, _ = ended.out.partition("note")
    assert "bias instability" not in table
    assert " to " not in table
    assert "note: a tuned Q also contains the errors of the filter's model" in ended.out
    text = Path("noise/imu_noise.toml").read_text()
    assert "# a tuned Q also contains" in text
    assert tomllib.loads(text)["accel_noise_density"] == pytest.approx((1e-2 / 0.02) ** 0.5)
    assert [path.name for path in Path("noise").glob("[!.]*")] == ["imu_noise.toml"]


MISTAKES = {
    "nothing": ([], "specify either a LOG or --tuned TUNING"),
    "both": (["LOG", "--tuned", "x"], "specify either a LOG or --tuned TUNING"),
    "no-file": (["absent.csv"], "absent.csv"),
    "short": (["short.csv"], "short.csv: the log is 4.95 s long, and there is no standstill of 10 s"),
    "moves": (["moving.csv"], "moving.csv: the IMU moves, and there is no standstill of 10 s"),
    "no-imu": (["table.csv"], "no IMU samples found"),
    "package": (["LOG", "--to", "ardupilot"], "--to"),
    "tuning": (["--tuned", "absent"], "absent"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line(sigmaswarm, log: Path, here: Path, case: str):
    table = pl.read_csv(log)
    table.head(100).write_csv("short.csv")
    table.with_columns(gz=(pl.col("t") / 3).sin()).write_csv("moving.csv")
    pl.DataFrame({"a": [1, 2], "b": [3, 4]}).write_csv("table.csv")
    arguments, expected = MISTAKES[case]
    ended = sigmaswarm("noise", *(str(log) if a == "LOG" else a for a in arguments))
    assert ended.code == 2
    assert expected in ended.err
    assert "Traceback" not in ended.err
    assert ended.err.strip().splitlines()[-1].startswith("sigmaswarm: ")


def changed(path: Path) -> dict[Path, int]:
    """Return modification times, ns."""
    return {file: file.stat().st_mtime_ns for file in (path, *path.rglob("*"))}


@pytest.mark.parametrize(
    ("first", "second", "file"),
    [
        (("noise", "LOG", "--out", "n"), (), "n"),
        (("plot", "DRIVE"), (), "urban-clear-00.png"),
        (("plot", "DRIVE", "--out", "p.png"), (), "p.png"),
        (("run", "TUNED", "DRIVE", "--out", "e.csv"), (), "e.csv"),
        (("run", "TUNED", "DRIVE", "--out", "e.ros2"), (), "e.ros2"),
        (("run", "TUNED", "DRIVE", "--out", "e.csv", "--truth", "t.tum"), ("--out", "f.csv"), "t.tum"),
        (("report", "E", "--out", "r.html"), (), "r.html"),
        (("import", "LOG", "--show", "--save-recipe", "r.toml"), (), "r.toml"),
    ],
)
def test_output_is_replaced_only_with_overwrite(
    sigmaswarm: Command, tuned: Path, drives: Path, log: Path, here: Path, first, second, file: str
):
    places = {"DRIVE": drives / "urban-clear-00", "TUNED": tuned, "LOG": log, "E": "e"}
    if "E" in first:
        assert sigmaswarm("evaluate", tuned, places["DRIVE"], "--out", "e").code == 0
    command = [places.get(word, word) for word in first]
    again = [*command, *second]
    if second:  # a repeated option
        place = command.index("--out")
        again = [*command[:place], *second, *command[place + 2 :]]
    assert sigmaswarm(*command).code == 0
    before = changed(here / file)
    ended = sigmaswarm(*again)
    assert ended.code == 2 and ended.err.count("\n") == 1
    assert file in ended.err and "add --overwrite" in ended.err
    assert changed(here / file) == before
    assert sigmaswarm(*again, "--overwrite").code == 0
    assert changed(here / file) != before
