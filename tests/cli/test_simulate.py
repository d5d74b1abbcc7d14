"""`sigmaswarm simulate` and `plot`: every option, reproducible bytes, interruption and resumption."""

import dataclasses
import hashlib
import inspect
import json
import threading
from pathlib import Path

import numpy as np
import pytest

import sigmaswarm as library
from sigmaswarm.cli.simulate import JITTER, SimulateOptions
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.simulation import (
    ENVIRONMENTS,
    GPS_GRADES,
    IMU_GRADES,
    MANEUVERS,
    ODOMETER_GRADES,
    TERRAINS,
    VEHICLES,
)
from sigmaswarm.simulation.scenarios import Scenario
from support import make_drive

pytestmark = pytest.mark.usefixtures("simulated_anew")
SOME = ("--maneuver", "turns", "brake", "--environment", "rain", "--runs", 2, "--seed", 7)
NAMES = [f"{m}-rain-0{run}" for m in ("turns", "brake") for run in range(2)]


def digests(folder: str) -> dict[str, str]:
    """Return the digest of every file below a folder."""
    files = sorted(p for p in Path(folder).rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.long
def test_the_bytes_do_not_depend_on_the_number_of_workers(sigmaswarm, here: Path):
    said = json.loads(sigmaswarm("simulate", "--out", "a", *SOME, "--workers", 1, "--json").out)
    assert said == {"drives": [f"a/{name}" for name in NAMES], "written": 4, "kept": 0}
    ended = sigmaswarm("simulate", "--out", "b", *SOME, "--workers", 2)
    assert ended.out.splitlines() == ["wrote 4 drives to b", "next: sigmaswarm plot b/turns-rain-00"]
    assert "4/4 drives" in ended.err
    assert len(digests("a")) == 4 * 4
    assert digests("a") == digests("b")
    assert len({v for k, v in digests("a").items() if k.endswith("imu.csv")}) == 4
    other = sigmaswarm("simulate", "--out", "c", *SOME[:-1], 8)
    assert other.code == 0
    assert not set(digests("a").values()) & set(digests("c").values())


def test_resume_adds_missing_drives_with_the_same_bytes(sigmaswarm, here: Path):
    sigmaswarm("simulate", "--out", "whole", *SOME)
    sigmaswarm(
        "simulate", "--out", "part", "--maneuver", "turns", "--environment", "rain", "--runs", 1, "--seed", 7
    )
    kept = Path("part/turns-rain-00/imu.csv")
    touched = kept.stat().st_mtime_ns
    said = json.loads(sigmaswarm("simulate", "--out", "part", *SOME, "--resume", "--json").out)
    assert (said["written"], said["kept"], len(said["drives"])) == (3, 1, 4)
    assert kept.stat().st_mtime_ns == touched
    assert digests("part") == digests("whole")
    again = sigmaswarm("simulate", "--out", "part", *SOME, "--resume")
    assert "wrote 0 drives to part, kept 4" in again.out
    assert again.err == ""


def test_resume_does_not_mix_drives_of_other_options(sigmaswarm, here: Path):
    base = ("--maneuver", "urban", "--environment", "rain", "--duration", 30, "--gps", "white-1m")
    assert sigmaswarm("simulate", "--out", "s", *base, "--runs", 1).code == 0
    before = digests("s")
    assert sigmaswarm("simulate", "--out", "s", *base, "--runs", 1, "--resume").code == 0
    for more, said in (
        (("--seed", 1), "seed 0, not 1"),
        (("--imu", "ideal"), "imu icm-20602, not ideal"),
        (("--gps", "ideal"), "gps white-1m, not ideal"),
        (("--vehicle", "model3-carla"), "vehicle model3, not model3-carla"),
        (("--duration", 40), "duration 30.0, not 40.0"),
        (("--jitter",), "jitter 0.0, not 0.002"),
        (("--vibration",), "vibration 0.0, not 1.0"),
        (("--gnss-degradation",), "gnss_degradation False, not True"),
        (("--terrain", "hilly"), "terrain flat, not hilly"),
    ):
        changed = {base[i]: base[i : i + 2] for i in range(0, len(base), 2)} | {more[0]: more}
        ended = sigmaswarm(
            "simulate", "--out", "s", *(o for given in changed.values() for o in given), "--resume"
        )
        assert ended.code == 2, more
        assert f"sigmaswarm: s/urban-rain-00/drive.toml: was made with {said}" in ended.err
        assert ended.err.count("\n") == 1
        assert digests("s") == before


def test_every_option_reaches_the_drive(sigmaswarm, here: Path):
    options = {"imu": "mpu-6050", "gps": "f9p-rtk", "vehicle": "model3-carla", "seed": 3}
    flags = ["--jitter", "--vibration", "--gnss-degradation"]
    given = [part for key, value in options.items() for part in (f"--{key}", value)]
    where = ["--maneuver", "urban", "brake", "--environment", "rain", "--runs", 1, "--duration", 30]
    assert sigmaswarm("simulate", "--out", "s", *where, *given, *flags).code == 0
    drive = read_drive("s/urban-rain-00")
    expected = library.simulate(
        "urban", "rain", duration=30.0, jitter=JITTER, vibration=1.0, gnss_degradation=True, **options
    )
    assert drive.metadata == expected.metadata
    np.testing.assert_array_equal(drive.imu.ax, expected.imu.ax)
    np.testing.assert_array_equal(drive.gps.x, expected.gps.x)
    assert drive.duration == pytest.approx(30.0, abs=0.1)  # the clock has jitter
    assert read_drive("s/brake-rain-00").metadata["scenario"]["vibration"] == 1.0


def test_workers_set_the_number_of_threads(sigmaswarm, here: Path, monkeypatch):
    threads, write = set(), library.write_drive

    def noted(drive, path):
        threads.add(threading.current_thread().name)
        return write(drive, path)

    monkeypatch.setattr(library, "write_drive", noted)
    assert sigmaswarm("simulate", "--out", "s", *SOME, "--workers", 1).code == 0
    assert len(threads) == 1


def test_the_defaults_are_the_library_s():
    said = {field.name: field for field in dataclasses.fields(SimulateOptions)}
    meant = inspect.signature(Scenario).parameters
    for name in ("imu", "gps", "vehicle", "seed", "duration"):
        assert said[name].default == meant[name].default, name
    assert said["runs"].default == inspect.signature(library.simulate_many).parameters["runs"].default


def test_help_names_every_choice(sigmaswarm):
    said = "".join(line.strip("│ ") + " " for line in sigmaswarm("simulate", "--help-all").out.splitlines())
    for choices in (MANEUVERS, ENVIRONMENTS, IMU_GRADES, GPS_GRADES, VEHICLES, TERRAINS, ODOMETER_GRADES):
        assert [name for name in choices if name not in said] == []


def test_environments_with_equal_friction_are_reported(sigmaswarm, here: Path):
    shared = sigmaswarm(
        "simulate", "--out", "a", "--maneuver", "brake", "--environment", "clear", "fog", "--runs", 1
    )
    assert "drives in the environments clear, night and fog differ only in their random numbers" in shared.out
    apart = sigmaswarm(
        "simulate", "--out", "b", "--maneuver", "brake", "--environment", "clear", "rain", "--runs", 1
    )
    assert "differ only" not in apart.out


@pytest.mark.long
def test_a_failure_gives_one_line_and_can_be_resumed(sigmaswarm, here: Path, monkeypatch):
    """The disk becomes full: written drives are complete, and --resume continues."""
    write = library.write_drive

    def full(drive, path):
        if drive.name == NAMES[2]:
            raise OSError(28, "No space left on device", str(path))
        return write(drive, path)

    monkeypatch.setattr(library, "write_drive", full)
    ended = sigmaswarm("simulate", "--out", "s", *SOME, "--workers", 1)
    assert ended.code == 2
    assert ended.err.splitlines()[-1] == f"sigmaswarm: s/{NAMES[2]}: No space left on device"
    assert "Traceback" not in ended.err
    monkeypatch.setattr(library, "write_drive", write)
    assert sigmaswarm("simulate", "--out", "s", *SOME, "--resume").code == 0
    sigmaswarm("simulate", "--out", "t", *SOME)
    assert digests("s") == digests("t")


@pytest.mark.usefixtures("painted")
def test_plot_draws_a_simulated_drive(sigmaswarm, here: Path):
    write = library.write_drive(library.simulate("outages", "rain"), "somewhere")
    ended = sigmaswarm("plot", write)
    assert ended.out == "wrote outages-rain-00.png\n"
    assert Path("outages-rain-00.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.usefixtures("painted")
def test_plot_draws_a_recorded_drive_without_truth(sigmaswarm, here: Path, caplog):
    library.write_drive(make_drive(duration=20.0, truth=False, name="by-me"), "recorded")
    ended = sigmaswarm("plot", "recorded", "--json")
    assert json.loads(ended.out) == {"out": "by-me.png"}
    assert Path("by-me.png").read_bytes().startswith(b"\x89PNG")
    assert ended.err == ""
    assert [record.getMessage() for record in caplog.records] == []  # no warning from matplotlib
