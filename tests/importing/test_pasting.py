"""The command that `import --show` proposes works for the logs of every reader; omitted columns are listed."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat

from cli.conftest import Command, sigmaswarm
from fuzzing.seeds import SEEDS, SHORT
from importing.logs import EPOCH, city_drive
from sigmaswarm import diagnose, read_drive, write_drive
from sigmaswarm.geodesy import enu_to_geodetic
from support import quickly

__all__ = ["sigmaswarm"]
G = 9.80665
QUICK = {"csv", "ros1", "phyphox"}


def pasted(said: str) -> list[str]:
    """The words behind `sigmaswarm` of the command that was proposed."""
    (line,) = [line for line in said.splitlines() if line.startswith("next: sigmaswarm import ")]
    return shlex.split(line)[2:]


@pytest.mark.parametrize("name", quickly([(n,) for n in SEEDS if SEEDS[n].form], lambda n: n in QUICK))
def test_a_sound_log(tmp_path: Path, sigmaswarm: Command, monkeypatch: pytest.MonkeyPatch, name: str):
    seed = SEEDS[name]
    imu = write_drive(SHORT, tmp_path / "imu") / "imu.csv"
    pl.read_csv(imu).with_columns(pl.col("t") + EPOCH).write_csv(imu)
    log = seed.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    made = ["--gps-from-truth", "5,0"] if seed.form == "kitti" else []
    asked = [imu, "--gps", log] if seed.beside else [log, *made]
    ended = sigmaswarm("import", *asked, "--show")
    assert ended.code == 0, ended.err
    ended = sigmaswarm(*pasted(ended.out))
    assert ended.code == 0, ended.err
    assert len(read_drive(tmp_path / "drive").gps) > 5


DRIVE = city_drive()
ODD = {
    "acc_fwd_g": DRIVE.imu.ax / G,
    "acc_right_g": -DRIVE.imu.ay / G,
    "yaw_rate_dps_cw": -np.degrees(DRIVE.imu.gz),
    "engine_temp": np.full(len(DRIVE.imu), 90.0),
}
LAT, LON, _ = enu_to_geodetic(
    np.column_stack([DRIVE.gps.x, DRIVE.gps.y, 0 * DRIVE.gps.x]), (50.0, 8.0, 100.0)
).T
FIXES = {
    "gnss_lat": LAT,
    "gnss_lng": LON,
    "hacc_m": np.full(len(DRIVE.gps), 1.414),
    "sats": np.full(len(LAT), 9.0),
}


def tables() -> tuple[pl.DataFrame, pl.DataFrame]:
    imu, gps = (np.round((EPOCH + t.time) * 1e6).astype(np.int64) for t in (DRIVE.imu, DRIVE.gps))
    return pl.DataFrame({"stamp_us": imu, **ODD}), pl.DataFrame({"stamp_us": gps, **FIXES})


def folder_of(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        log = folder / "a log; of 'mine'"
        log.mkdir()
        for frame, name in zip(tables(), ("motion data", "fixes"), strict=True):
            getattr(frame, f"write_{suffix}")(log / f"{name}.{suffix}")
        return log

    return write


def one_table(folder: Path) -> Path:
    imu, gps = tables()
    imu.join(gps, on="stamp_us", how="left").write_csv(folder / "log.csv", separator=";")
    return folder / "log.csv"


def matlab(folder: Path) -> Path:
    imu, gps = ({name: frame[name].to_numpy() for name in frame.columns} for frame in tables())
    savemat(folder / "log.mat", {"motion": imu, "receiver": gps})
    return folder / "log.mat"


LOGS = {"csv": folder_of("csv"), "parquet": folder_of("parquet"), "one table": one_table, "matlab": matlab}


@pytest.mark.parametrize(
    "kind", quickly([(kind,) for kind in LOGS], lambda kind: kind in ("csv", "one table"))
)
def test_a_log_with_names_of_its_own(
    tmp_path: Path, sigmaswarm: Command, monkeypatch: pytest.MonkeyPatch, kind: str
):
    log = LOGS[kind](tmp_path)
    monkeypatch.chdir(tmp_path)
    said = sigmaswarm("import", log, "--show").out
    left, read = ("".join(re.findall(rf"^{start} .*", said, re.MULTILINE)) for start in ("not used", "read"))
    assert "engine_temp" in left and "sats" in left
    command = pasted(said)
    for name in (*ODD, *FIXES):
        assert any(name in word for word in command) or name in left or f"={name}" in read, name
    ended = sigmaswarm(*command)
    assert ended.code == 0, ended.err
    drive = read_drive(tmp_path / "drive")
    for name in ("ax", "ay", "gz"):
        np.testing.assert_allclose(getattr(drive.imu, name), getattr(DRIVE.imu, name), atol=1e-6)
    assert len(drive.gps) == len(DRIVE.gps) and not diagnose(drive).serious


def test_what_is_not_enough_is_no_command(tmp_path: Path, sigmaswarm: Command):
    tables()[0].write_csv(tmp_path / "imu.csv")
    said = sigmaswarm("import", tmp_path / "imu.csv", "--show").out
    assert (
        "add these options to the command (some columns are still missing, see below):" in said
        and "no position fixes found" in said
    )
    assert "next:" not in said
