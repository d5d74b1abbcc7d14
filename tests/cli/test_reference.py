"""`sigmaswarm reference`: a drive with truth from a reference receiver, and mistakes in one line."""

import json
from dataclasses import replace
from pathlib import Path

from cli.conftest import Command
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.simulation import simulate


def test_it_writes_a_drive_with_truth(sigmaswarm: Command, here: Path):
    cheap = replace(simulate("urban", gps="white-1m", duration=40.0, imu_rate=50.0), truth=None)
    write_drive(cheap, here / "cheap")
    write_drive(
        replace(simulate("urban", gps="f9p-rtk", duration=40.0, imu_rate=50.0), truth=None), here / "rtk"
    )
    asked = ("reference", "cheap", "--fixes", "rtk", "--out", "made", "--lever-arm", "0,0,0")
    done = sigmaswarm(*asked)
    assert done.code == 0, done.err
    assert "used 200 of 200 fixes; the truth covers " in done.out
    assert done.out.splitlines()[-1] == "next: sigmaswarm tune made --out tuned"
    made = read_drive(here / "made")
    assert made.truth.std_x.max() <= 0.1
    assert made.truth.std_theta is not None
    assert made.gps.x.tobytes() == cheap.gps.x.tobytes()
    assert made.metadata["reference"]["fixes"] == "rtk"

    again = sigmaswarm(*asked)
    assert (again.code, again.err.count("\n")) == (2, 1)
    assert "--overwrite" in again.err
    told = json.loads(sigmaswarm(*asked, "--overwrite", "--json").out)
    assert told["truth_samples"] == len(made.truth)

    late = sigmaswarm("reference", "cheap", "--fixes", "rtk", "--out", "late", "--offset", "500")
    assert late.code == 2
    assert "0 common fixes are too few; convert both to one clock with --offset" in late.err
    arm = sigmaswarm("reference", "cheap", "--fixes", "rtk", "--out", "late", "--lever-arm", "1,2")
    assert "--lever-arm '1,2' is not 3 numbers" in arm.err
    assert not (here / "late").exists()
