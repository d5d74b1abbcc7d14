"""Counters with an unknown rate: the rate follows from a known clock, the motion or the duration, or is rejected."""

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import EPOCH, city_drive, imported
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from support import diagonal, several, some

DRIVE = city_drive()
IMU, GPS = DRIVE.imu, DRIVE.gps
START = 1234.5  # s, of the counter at t = 0


def counted(time: np.ndarray, rate: float, bits: int = 0) -> np.ndarray:
    """Return ticks; a counter of ``bits`` wraps at 40 s, and again after its period."""
    start = 100 * 2**bits / rate - 40.0 if bits else START
    ticks = np.round((start + time) * rate).astype(np.int64)
    return ticks % 2**bits if bits else ticks


def write(folder: Path, imu: dict[str, np.ndarray], gps: dict[str, object], gain: float = 1.0) -> Path:
    lat, lon, _ = enu_to_geodetic(np.column_stack([GPS.x, GPS.y, 0 * GPS.x]), (50.0, 8.0, 100.0)).T
    forces = {"ax": IMU.ax, "ay": IMU.ay, "az": 0 * IMU.ax + 9.81, "gz [rad/s]": gain * IMU.gz}
    pl.DataFrame({**imu, **forces}).write_csv(folder / "imu.csv")
    pl.DataFrame({**gps, "lat": lat, "lon": lon}).write_csv(folder / "gps.csv")
    return folder


def error(folder: Path, **options) -> float:
    """Return the largest error of a time relative to the first IMU sample, s."""
    drive = imported(folder, **options).drive
    assert (len(drive.imu), len(drive.gps)) == (len(IMU), len(GPS))
    pairs = ((drive.imu.time, IMU.time), (drive.gps.time, GPS.time))
    return max(float(np.abs(a - drive.imu.time[0] - b + IMU.time[0]).max()) for a, b in pairs)


def dates(time: np.ndarray) -> list[str]:
    return [datetime.fromtimestamp(EPOCH + t, UTC).strftime("%Y-%m-%d %H:%M:%S.%f") for t in time.tolist()]


CLOCKS = {
    "unix": {"utc": EPOCH + GPS.time},
    "date": {"date_time": dates(GPS.time)},
    "week": {"week": np.full(len(GPS), 2311), "tow": 100.0 + GPS.time},
    "seconds": {"time": GPS.time},
    "whole seconds": {"unix_time": EPOCH + np.floor(GPS.time).astype(np.int64)},
}


@pytest.mark.parametrize(("clock", "rate"), diagonal(CLOCKS, [32768, 125_000, 72_000_000, 10_000]))
def test_the_rate_follows_from_a_known_clock_of_the_fixes(tmp_path: Path, rate: int, clock: str):
    folder = write(
        tmp_path, {"tick": counted(IMU.time, rate)}, {"tick": counted(GPS.time, rate), **CLOCKS[clock]}
    )
    assert error(folder) < 5e-3
    notes = " ".join(imported(folder).notes)
    assert f"tick is read as ticks of {rate:,} Hz" in notes and "are read as" not in notes


@pytest.mark.parametrize(("rate", "bits"), [(32768, 16), (32768, 24), (125_000, 24), (72_000_000, 32)])
@pytest.mark.parametrize("stated", [False, True])
def test_a_counter_of_another_rate_is_unwrapped(tmp_path: Path, rate: int, bits: int, stated: bool):
    """Not called a clock that restarts: with a known clock of the fixes, or with a stated rate."""
    clock = {} if stated else CLOCKS["unix"]
    gps = {"tick": counted(GPS.time, rate, bits), **clock}
    folder = write(tmp_path, {"tick": counted(IMU.time, rate, bits)}, gps)
    options = {"time": f"tick/{rate}"} if stated else {}
    assert error(folder, **options) < 5e-3
    assert any(f"a counter of 2^{bits} ticks wraps" in note for note in imported(folder, **options).notes)


def test_a_counter_that_wraps_between_fixes_is_refused(tmp_path: Path):
    gps = {"tick": counted(GPS.time, 72e6, 24), **CLOCKS["unix"]}
    folder = write(tmp_path, {"tick": counted(IMU.time, 72e6, 24)}, gps)
    with pytest.raises(InputError, match="too fast for the rate of the rows"):
        imported(folder)


@pytest.mark.parametrize(
    ("rate", "bits"), several([(32768, 0), (10_000, 0), (72_000_000, 0), (125_000, 0), (125_000, 24)], 3)
)
def test_the_motion_shows_the_rate_of_a_shared_counter(tmp_path: Path, rate: int, bits: int):
    folder = write(tmp_path, {"tick": counted(IMU.time, rate, bits)}, {"tick": counted(GPS.time, rate, bits)})
    with pytest.raises(InputError, match=f"agrees at {rate:,} ticks per s") as caught:
        imported(folder)
    assert error(folder, maps=re.findall(r'"((?:imu|gps)\.t=[^"]+)"', str(caught.value))) < 5e-3


@pytest.mark.parametrize("every", some([1, 2, 5]))
def test_the_motion_shows_the_rate_of_rows_without_a_time(tmp_path: Path, every: int):
    lat, lon, _ = enu_to_geodetic(np.column_stack([GPS.x, GPS.y, 0 * GPS.x]), (50.0, 8.0, 100.0)).T
    fix = np.searchsorted(GPS.time, IMU.time + 1e-9, side="right") - 1
    held = {n: np.where(fix < 0, np.nan, v[fix]) for n, v in (("lat", lat), ("lon", lon))}
    log = pl.DataFrame({"ax": IMU.ax, "ay": IMU.ay, "gz [rad/s]": IMU.gz, **held}).fill_nan(None)
    log[::every].write_csv(tmp_path / "log.csv")
    rate = 50 / every
    with pytest.raises(InputError, match=f"motion of IMU and fixes agrees at {rate:g} rows per s") as caught:
        imported(tmp_path / "log.csv")
    maps = re.findall(r'"((?:imu|gps)\.t=[^"]+)"', str(caught.value))
    time = imported(tmp_path / "log.csv", maps=maps).drive.imu.time
    np.testing.assert_allclose(time - time[0], IMU.time[::every] - IMU.time[0], atol=1e-9)


@pytest.mark.parametrize("rate", [32768, 125_000, 72_000_000])
def test_the_duration_shows_the_rate_of_a_counter_of_the_imu(tmp_path: Path, rate: int):
    """The remedies of the messages lead to the drive."""
    folder = write(tmp_path, {"tick": counted(IMU.time, rate)}, CLOCKS["unix"])
    with pytest.raises(InputError, match="if IMU and fixes cover the same") as caught:
        imported(folder)
    (remedy,) = re.findall(r'"(imu\.t=tick/[^"]+)"', str(caught.value))
    assert remedy == f"imu.t=tick/{rate}"
    with pytest.raises(InputError, match="if both logs began at the same time") as caught:
        imported(folder, maps=[remedy])


@pytest.mark.parametrize("gain", [1.0, 1.6])
@pytest.mark.parametrize("end", ["begin", "end"])
def test_fixes_of_a_shorter_time_do_not_contradict_the_unit_of_the_imu(tmp_path: Path, end: str, gain: float):
    """A receiver may start later, or stop earlier, than the IMU; a gyro may have another scale."""
    folder = write(tmp_path, {"time": counted(IMU.time, 1000)}, {"time": START + GPS.time}, gain)
    fixes = pl.read_csv(folder / "gps.csv")
    (fixes[160:] if end == "begin" else fixes[:160]).write_csv(folder / "gps.csv")
    drive = imported(folder).drive
    assert drive.imu.time[-1] - drive.imu.time[0] == pytest.approx(IMU.time[-1] - IMU.time[0])


def test_motion_and_duration_show_the_rate_of_a_counter_of_the_imu(tmp_path: Path):
    folder = write(tmp_path, {"time": counted(IMU.time, 2000)}, {"time": 2 * START + GPS.time})
    with pytest.raises(
        InputError, match="the unit of the times is unknown; if IMU and fixes cover"
    ) as caught:
        imported(folder)
    assert re.findall(r'"(imu\.t=time/[^"]+)"', str(caught.value)) == ["imu.t=time/2000"]


def test_other_faults_do_not_name_a_rate(tmp_path: Path):
    folder = write(tmp_path, {"time": counted(IMU.time, 1000)}, {"time": START + GPS.time})
    places = {"x": 1e3 * GPS.x, "y": 1e3 * GPS.y}  # mm
    pl.DataFrame({"time": START + GPS.time, **places})[:160].write_csv(folder / "gps.csv")
    with pytest.raises(InputError, match="x and y are not in m") as caught:
        imported(folder)
    assert "ticks per s" not in str(caught.value)


@pytest.mark.parametrize(("rate", "gain"), [(1_000_000, 1.0), (1_000_000, 2.0), (1000, 8.0)])
def test_a_gyro_with_another_scale_does_not_change_the_rate(tmp_path: Path, rate: int, gain: float):
    """The accelerations contradict another rate."""
    folder = write(tmp_path, {"tick": counted(IMU.time, rate)}, {"tick": counted(GPS.time, rate)}, gain)
    assert error(folder) < 5e-3


@pytest.mark.parametrize(
    "options", [{"time": "tick/125000"}, {"maps": ["imu.t=tick/125000", "gps.t=tick/125000"]}, {}]
)
def test_a_stated_time_is_not_called_a_guess(tmp_path: Path, options: dict):
    rate = 125_000 if options else 1_000_000
    folder = write(tmp_path, {"tick": counted(IMU.time, rate)}, {"tick": counted(GPS.time, rate)})
    guesses = [note for note in imported(folder, **options).notes if "are read as" in note]
    assert guesses == ([] if options else ["the times in tick are read as us"])


@pytest.mark.parametrize(
    ("column", "maps"),
    [("alt_feet", ["gps.alt=alt_feet"]), ("gz", ["imu.gz=radians(gz)"]), ("ax", ["imu.ax=ax*9.8"])],
)
def test_a_mapped_column_is_not_called_a_guess(tmp_path: Path, column: str, maps: list[str]):
    """The note on accelerations in g also concerns ay and az, so it remains."""
    write(tmp_path, {"time": IMU.time}, {"time": GPS.time, "alt_feet": 100 + 0 * GPS.time})
    log = pl.read_csv(tmp_path / "imu.csv").rename({"gz [rad/s]": "gz"})
    log = log.with_columns(pl.col("ax", "ay", "az") / 9.80665, gz=pl.col("gz").degrees())
    log.write_csv(tmp_path / "imu.csv")
    before, after = (
        {note for note in imported(tmp_path, maps=m).notes if "read as" in note or "left out" in note}
        for m in ([], maps)
    )
    kept = {note for note in before if column not in note.split() or column == "ax"}
    kept -= {note for note in before if column == "gz" and "angular rates" in note}
    assert after == kept or (column == "ax" and any("accelerations are read as g" in n for n in after))
