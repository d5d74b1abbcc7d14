"""`sigmaswarm export`, and the formats of `sigmaswarm run` other than CSV."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from cli.conftest import Command
from sigmaswarm import Evaluation
from sigmaswarm.tuning.diagnostics import REMEDY
from sigmaswarm.wording import to_do

ROOT = Path(__file__).parents[2]

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def test_export_names_the_written_files(sigmaswarm: Command, tuned: Path, here: Path):
    ended = sigmaswarm("export", tuned, "--to", "robot_localization", "--out", "ros")
    wrote, following = ended.out.splitlines()
    assert (ended.code, wrote) == (0, "wrote ros: robot_localization.yaml")
    assert following.startswith("next: ") and "ros/robot_localization.yaml" in following
    ended = sigmaswarm("export", tuned, "--to", "filterpy", "--out", "py", "--json")
    assert json.loads(ended.out) == {"written": ["py/run_filter.py"]}


def test_c_of_a_tuning_with_a_mounting_states_it(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    def mounted(*angles: float) -> str:
        content = tomllib.loads(tuned.read_text())
        data = [{"name": "monday", "imu_mounting_deg": angles}]
        Path("tuning.toml").write_text(tomli_w.dumps(content | {"data": data}))
        return "tuning.toml"

    said = sigmaswarm("export", mounted(0.0, 10.5, 90.0), "--to", "c99", "--out", "c").out
    assert (
        "the IMU is rotated relative to the vehicle (roll, pitch, yaw: 0, 10.5, 90 deg). In your program, "
        in said
    )
    assert "pass each sample in SI units to ins_gps_turn_imu() first\nnext: " in said
    replayed = sigmaswarm(
        "export", "tuning.toml", "--to", "c99", "--out", "r", "--replay", drives / "urban-clear-00"
    ).out
    assert " first; the samples in replay.csv are rotated already\nnext: " in replayed
    assert "ins_gps_turn_imu" in Path("c/ins_gps.c").read_text()
    assert "ins_gps_turn_imu" not in sigmaswarm("export", tuned, "--to", "c99", "--out", "d").out
    ended = sigmaswarm("export", mounted(0.0, np.nan, 90.0), "--to", "c99", "--out", "e")
    assert (ended.code, ended.err.count("\n")) == (2, 1) and "imu_mounting_deg" in ended.err


def test_robot_localization_from_its_yaml_and_back(sigmaswarm: Command, drives: Path, here: Path):
    drive = drives / "urban-clear-00"
    texts = "imu0_config: [" + "false, " * 11 + "true, true, true, false]\ntwo_d_mode: true\n"
    Path("ekf.yaml").write_text(texts)
    search = ("--particles", 4, "--generations", 2)
    ended = sigmaswarm("tune", drive, "--start", "ekf.yaml", "--out", "t", *search)
    assert ended.code == 0, ended.err
    assert "model: robot-localization" in ended.out and "from which the search started" in ended.out
    ended = sigmaswarm("evaluate", "t", drive, "--against", "ekf.yaml", "--trust-log")
    assert ended.code == 0 and "other EKF" in ended.out
    out = ("--to", "robot-localization", "--out", "ekf")
    ended = sigmaswarm("export", "t", *out, "--check", drive, "--against", "ekf.yaml")
    assert ended.code == 0, ended.err
    page = Path("ekf/README.md").read_text()
    assert "## Accuracy on urban-clear-00" in page and "| other EKF, robot-localization (ekf.yaml) |" in page
    assert "TRAINING DATA: the tuning used all of the 30 s of urban-clear-00" in page
    for wrong, said in (
        (("--to", "robot-localization", "--out", "new", "--against", "t"), "--against needs --check"),
        (("--to", "filterpy", "--out", "new"), "filterpy does not support robot-localization"),
    ):
        ended = sigmaswarm("export", "t", *wrong)
        assert (ended.code, ended.err.count("\n")) == (2, 1) and said in ended.err
    Path("ekf.yaml").write_text("frequency: 30.0")
    ended = sigmaswarm("evaluate", "t", drive, "--against", "ekf.yaml")
    assert (ended.code, ended.err.count("\n")) == (2, 1) and "ekf.yaml: has neither" in ended.err


@pytest.mark.parametrize(("improvement", "exported"), [(-5.0, False), (-0.5, True), (5.0, True)])
def test_no_export_is_proposed_if_the_other_filter_has_the_smaller_drift(
    sigmaswarm: Command,
    tuned: Path,
    drives: Path,
    here: Path,
    monkeypatch,
    improvement: float,
    exported: bool,
):
    monkeypatch.setattr(Evaluation, "is_worse_than_untuned", False)
    monkeypatch.setattr(Evaluation, "improvement", lambda *_, **__: improvement)
    monkeypatch.setattr("sigmaswarm.scoring.remarks.worse_than_raw", lambda _: ())
    ended = sigmaswarm("evaluate", tuned, drives / "urban-clear-01", "--against", tuned, "--out", "e")
    assert ended.code == 0, ended.err
    assert ("sigmaswarm export" in ended.out) == exported
    assert (f"smaller drift, {tuned}" in ended.out) != exported


def test_no_use_is_proposed_of_a_filter_that_should_not_be_used(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path, monkeypatch
):
    drive = drives / "urban-clear-00"
    export = ("export", "bad.toml", "--to", "filterpy", "--out", "py", "--overwrite")
    text = tuned.read_text()
    monkeypatch.setattr(Evaluation, "is_worse_than_untuned", False)
    for remedy, repeated in ((REMEDY, True), ("tune with more trials", False)):
        warned = {"cost": 1.0, "objective": "innovation-t", "warnings": [to_do(remedy, "it diverges")]}
        Path("bad.toml").write_text(text + tomli_w.dumps({"result": warned}))
        ended = sigmaswarm(*export)
        assert ended.code == 0 and Path("py/run_filter.py").exists()
        assert ("bad.toml: DO NOT USE THIS FILTER; " in ended.err) is repeated
        assert "it diverges" in ended.err or not repeated
        assert ("\nnext: " not in ended.out) is repeated
        evaluated = sigmaswarm("evaluate", "bad.toml", drive, "--out", "e", "--overwrite")
        assert ("sigmaswarm export" not in evaluated.out) is repeated
        assert ("bad.toml: DO NOT USE THIS FILTER; " in evaluated.err) is repeated
        assert "TO DO" not in evaluated.out  # the line is printed by tune only


def test_export_states_that_slow_vehicles_have_no_alignment_in_c(
    sigmaswarm: Command, tuned: Path, here: Path
):
    content = tomllib.loads(tuned.read_text())
    for slow in (True, False):
        data = [{"name": "robot", "slow": True}, {"name": "car", "slow": slow}]
        Path("t.toml").write_text(tomli_w.dumps(content | {"data": data}))
        said = sigmaswarm("export", "t.toml", "--to", "c99", "--out", "c", "--overwrite").out
        assert ("(12 km/h), which the alignment in C requires. Compute the initial state" in said) is slow


@pytest.mark.long
@needs_gcc
@pytest.mark.usefixtures("unoptimized")
def test_exported_columns_are_compared_with_the_bank(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path
):
    drive = drives / "urban-clear-00"
    ended = sigmaswarm("export", tuned, "--to", "c99", "--out", "c", "--lanes", 3, "--check", drive)
    (found,) = re.findall(r"C is within (\S+) of a LiveFilterBank without searches", ended.out)
    assert (ended.code, float(found) < 1e-9) == (0, True)
    assert "#define INS_GPS_LANES 3" in Path("c/ins_gps.h").read_text()
    wrong = sigmaswarm("export", tuned, "--to", "c99", "--out", "c", "--lanes", 17)
    assert (wrong.code, wrong.err.count("\n")) == (2, 1)
    assert "lanes = 17 is out of range; choose 2 to 16" in wrong.err
    wrong = sigmaswarm("export", tuned, "--to", "filterpy", "--out", "py", "--lanes", 4)
    assert wrong.code == 2
    assert "--lanes needs --to c99" in wrong.err


@needs_gcc
def test_the_commands_of_the_page(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    drive = drives / "urban-clear-00"
    ended = sigmaswarm("export", tuned, "--to", "c99", "--out", "c", "--replay", drive)
    assert ended.code == 0
    assert sigmaswarm("run", tuned, drive, "--out", "ours.csv").code == 0
    (command,) = re.findall(r"^cc .*", (ROOT / "docs" / "export.md").read_text(), re.MULTILINE)
    subprocess.run(command, cwd="c", shell=True, check=True)
    subprocess.run("./replay < replay.csv > theirs.csv", cwd="c", shell=True, check=True)
    theirs = np.loadtxt("c/theirs.csv", delimiter=",", skiprows=1)
    ours = np.loadtxt("ours.csv", delimiter=",", skiprows=1)
    header = Path("ours.csv").read_text().splitlines()[0]
    assert Path("c/theirs.csv").read_text().splitlines()[0] == header
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-9)
    (following,) = re.findall(
        r"^next: (.*)", ended.out, re.MULTILINE
    )  # the command that export prints, for the parent folder
    assert command in following
    subprocess.run(following, shell=True, check=True)
    assert Path("c/estimate.csv").read_bytes() == Path("c/theirs.csv").read_bytes()


@needs_gcc
@pytest.mark.usefixtures("unoptimized")
def test_the_c_is_checked_on_drives(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    ended = sigmaswarm("export", tuned, "--to", "c99", "--out", "c", "--check", drives / "urban-clear-00")
    assert ended.code == 0, ended.err
    pattern = (
        r"^urban-clear-00: every state in C is within (\S+) of sigmaswarm run"
        r".*in single precision the position differs by at most (\S+) mm and the heading by (\S+) degrees$"
    )
    (found,) = re.findall(pattern, ended.out, re.MULTILINE)
    assert float(found[0]) < 1e-9 and float(found[1]) < 10.0 and float(found[2]) < 0.01
    ended = sigmaswarm(
        "export",
        tuned,
        "--to",
        "c99",
        "--out",
        "c",
        "--overwrite",
        "--json",
        "--check",
        drives / "urban-clear-00",
    )
    (checked,) = json.loads(ended.out)["checked"]
    assert checked["drive"] == "urban-clear-00" and checked["double"]["state"] < 1e-9


@needs_gcc
@pytest.mark.usefixtures("unoptimized")
def test_a_new_export_removes_builds_of_an_earlier_one(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path
):
    export = ("export", tuned, "--to", "c99", "--out", "c", "--overwrite")
    assert sigmaswarm(*export, "--check", drives / "urban-clear-00").code == 0
    assert {"libins_gps.so", "libins_gps_float.so"} <= {file.name for file in Path("c").iterdir()}
    for name in ("replay", "estimate.csv", "main.c"):
        Path("c", name).write_text("")
    ended = sigmaswarm(*export)
    assert ended.code == 0, ended.err
    (wrote,) = re.findall(r"^wrote c: (.*)$", ended.out, re.MULTILINE)
    exported = {Path(name).parts[0] for name in wrote.split(", ")}
    left = {file.name for file in Path("c").iterdir()} - exported
    assert left <= {"main.c", ".sigmaswarm-result.json", "__pycache__"}, left
    load = "import sys; sys.path.insert(0, 'c'); import ins_gps; ins_gps.Filter(0.0, [0.0] * 5, [0.0] * 25)"
    loaded = subprocess.run([sys.executable, "-c", load], capture_output=True, text=True, check=False)
    assert "libins_gps.so: cannot open shared object file" in loaded.stderr


@pytest.mark.usefixtures("unoptimized")
def test_export_proposes_the_next_command(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    drive = drives / "urban-clear-00"
    said = sigmaswarm("export", tuned, "--to", "filterpy", "--out", "py").out
    assert said.endswith("next: python py/run_filter.py DRIVE estimate.csv\n")
    export = ("export", str(tuned), "--to", "c99", "--out", "c")
    said = sigmaswarm(*export, "--check", drive).out
    (again,) = re.findall(r"next: sigmaswarm (.*?)    \(adds an input", said)
    assert shlex.split(again) == [*export, "--replay", str(drive), "--overwrite"]
    (shell,) = re.findall("next: (.*)", sigmaswarm(*shlex.split(again)).out)
    subprocess.run(shell, shell=True, check=True)
    assert (here / "c/estimate.csv").read_text().count("\n") > 100
    assert "--replay DRIVE --overwrite" in sigmaswarm(*export, "--overwrite").out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--to", "rust", "--out", "x"], 'Invalid value "rust" for --to'),
        (["--to", "c99"], "--out"),
        (["--to", "filterpy", "--out", "x", "--replay", "DRIVE"], "--replay needs --to c99"),
        (["--to", "c99", "--out", "x", "--replay", "nowhere"], "nowhere does not exist"),
        (["--to", "c99", "--out", "x", "--check", "nowhere"], "nowhere does not exist"),
        (
            ["--to", "filterpy", "--out", "x", "--check", "DRIVE"],
            "--check needs --to c99 or a tuning of the model robot-localization",
        ),
    ],
)
def test_a_mistake_in_export_gives_one_line(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path, arguments, said: str
):
    arguments = [drives / "urban-clear-00" if a == "DRIVE" else a for a in arguments]
    ended = sigmaswarm("export", tuned, *arguments)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert said in ended.err
    assert list(here.iterdir()) == []


def test_a_file_without_an_interval_is_refused(sigmaswarm: Command, tuned: Path, here: Path):
    Path("p.toml").write_text(tuned.read_text().replace("nominal_interval = 0.02\n", ""))
    ended = sigmaswarm("export", "p.toml", "--to", "c99", "--out", "x")
    assert ended.code == 2 and "add nominal_interval" in ended.err


def test_run_writes_maps_and_truth(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    drive = drives / "urban-clear-00"
    ended = sigmaswarm("run", tuned, drive, "--out", "e.kml")
    if ended.code == 2:
        assert "--origin LAT,LON" in ended.err
        ended = sigmaswarm("run", tuned, drive, "--out", "e.kml", "--origin", "49.0,8.4")
    assert ended.code == 0 and "<coordinates>" in Path("e.kml").read_text()
    assert sigmaswarm("run", tuned, drive, "--out", "e.tum", "--truth", "truth.tum").code == 0
    assert (
        len(Path("truth.tum").read_text().splitlines()) > len(Path("e.tum").read_text().splitlines()) > 1000
    )


@pytest.mark.parametrize("place", ["49", "north,8", "91,8", "49,181", "49,8,1,2", "nan,8"])
def test_an_invalid_place_is_refused(sigmaswarm: Command, tuned: Path, drives: Path, here: Path, place: str):
    ended = sigmaswarm("run", tuned, drives / "urban-clear-00", "--out", "e.kml", "--origin", place)
    assert ended.code == 2
    remedy = "write latitude (-90 to 90) and longitude (-180 to 180), for example 49.011,8.416"
    assert ended.err == f"sigmaswarm: --origin '{place}' is not a position; {remedy}\n"
    assert list(here.iterdir()) == []


def test_another_place_is_refused_for_a_drive_with_an_origin(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path
):
    shutil.copytree(drives / "urban-clear-00", "drive")
    about = Path("drive/drive.toml")
    if "origin" not in about.read_text():
        about.write_text("origin = [49.0, 8.4, 0.0]\n" + about.read_text())
    ended = sigmaswarm("run", tuned, "drive", "--out", "e.gpx", "--origin", "1,2")
    assert ended.code == 2 and "omit --origin" in ended.err
    assert sigmaswarm("run", tuned, "drive", "--out", "e.gpx").code == 0


def test_results_do_not_replace_other_files(sigmaswarm: Command, tuned: Path, drives: Path, here: Path):
    """An earlier result of the same kind is replaced as a whole; a folder with other files is refused."""
    drive = drives / "urban-clear-00"
    assert sigmaswarm("export", tuned, "--to", "c99", "--out", "c", "--replay", drive).code == 0
    assert (here / "c/replay.csv").exists()
    again = ("export", tuned, "--to", "c99", "--out", "c")
    ended = sigmaswarm(*again)
    assert ended.code == 2 and "choose another folder, for example --out c-2, or add --overwrite" in ended.err
    assert sigmaswarm("export", "nowhere", *again[2:]).err == ended.err  # the folder is checked first
    assert sigmaswarm(*again, "--overwrite").code == 0
    assert not (here / "c/replay.csv").exists()
    (here / "mine").mkdir()
    (here / "mine/page.html").write_text("mine")
    search = "--particles", 2, "--generations", 1
    for command in (
        ("export", tuned, "--to", "filterpy", "--out", "c"),
        ("evaluate", tuned, drive, "--out", "mine"),
        ("evaluate", tuned, drive, "--out", tuned),
        ("noise", drive, "--out", "mine"),
        ("tune", drive, "--out", "mine", *search),
        ("compare", drive, "--out", "mine", *search),
        ("learn", "noise-gru", tuned, drive, "--out", "mine"),
        ("study", "--out", "mine"),
        ("demo", "--out", "mine"),
    ):
        ended = sigmaswarm(*command)
        assert (ended.code, ended.err.count("\n")) == (2, 1), (command, ended.err)
        assert "choose another --out" in ended.err, ended.err
    assert [file.name for file in (here / "mine").iterdir()] == ["page.html"]
    (here / "mine/ins_gps.h").write_text(
        "mine"
    )  # an export can be next to other files, but does not replace them
    ended = sigmaswarm("export", tuned, "--to", "c99", "--out", "mine", "--overwrite")
    assert ended.code == 2 and "ins_gps.h: is not part of an earlier export" in ended.err
    (here / "mine/ins_gps.h").unlink()
    assert sigmaswarm("export", tuned, "--to", "c99", "--out", "mine").code == 0
    assert (here / "mine/page.html").read_text() == "mine"


def test_an_evaluation_replaces_the_page_of_the_last_and_not_its_own_tuning(
    sigmaswarm: Command, tuned: Path, drives: Path, here: Path
):
    drive = drives / "urban-clear-00"
    assert sigmaswarm("evaluate", tuned, drive, "--out", "e").code == 0
    assert sigmaswarm("report", "e").code == 0 and (here / "e/page.html").exists()
    ended = sigmaswarm("evaluate", "e", drive, "--out", "e")
    assert ended.code == 2 and "e: contains e, which this command reads; choose another --out" in ended.err
    ended = sigmaswarm("evaluate", "nowhere", drive, "--out", "e")  # the folder is checked first
    assert ended.code == 2 and "e: already contains an evaluation; choose another folder" in ended.err
    assert "--out e-2, or add --overwrite" in ended.err and (here / "e/page.html").exists()
    assert sigmaswarm("evaluate", tuned, drive, "--out", "e", "--overwrite").code == 0
    assert not (here / "e/page.html").exists()
    (here / "e/page.html").write_text("mine")
    ended = sigmaswarm("report", "e")
    assert ended.code == 2 and "is not part of the result in this folder; move it" in ended.err


def test_an_export_states_the_remedy_if_mountings_differ(sigmaswarm: Command, tuned: Path, here: Path):
    for name, second in (("one", (0.0, 10.5, 90.0)), ("two", (0.0, 10.5, 45.0))):
        content = tomllib.loads(tuned.read_text())
        data = [
            {"name": n, "imu_mounting_deg": m} for n, m in (("monday", (0.0, 10.5, 90.0)), ("friday", second))
        ]
        Path(f"{name}.toml").write_text(tomli_w.dumps(content | {"data": data}))
    note = "the export contains no rotation; rotate raw samples to x forward, y left, z up for the filter, or tune"
    assert note in sigmaswarm("export", "two.toml", "--to", "c99", "--out", "c").out
    assert note not in sigmaswarm("export", "one.toml", "--to", "c99", "--out", "d").out


def test_a_configuration_of_robot_localization_in_place_of_a_tuning(
    sigmaswarm: Command, drives: Path, here: Path
):
    Path("ekf.yaml").write_text(
        "imu0_config: [" + "false, " * 11 + "true, true, true, false]\ntwo_d_mode: true\n"
    )
    assert sigmaswarm("export", "ekf.yaml", "--to", "robot_localization", "--out", "ekf").code == 0
    for command, fault in (
        (
            ("export", "ekf.yaml", "--to", "c99", "--out", "c"),
            "c99 does not support robot-localization; use planar8",
        ),
        (
            ("evaluate", "ekf.yaml", drives / "urban-clear-00"),
            "evaluate a tuning and add --against ekf.yaml, or use",
        ),
    ):
        ended = sigmaswarm(*command)
        assert (ended.code, ended.err.count("\n")) == (2, 1) and fault in ended.err, ended.err
    assert sigmaswarm("run", "ekf.yaml", drives / "urban-clear-00", "--out", "e.csv").code == 0
