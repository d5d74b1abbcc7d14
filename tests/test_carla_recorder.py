"""The recorder with unmodified CARLA clients and the simulated server: all outputs of a recording."""

import json
import tomllib
import warnings
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import sigmaswarm
from sigmaswarm.errors import SigmaswarmWarning
from standin.process import record, stand_in
from standin.world import DEFAULTS

ALL = ("cruise", "turns", "accelerate", "brake", "outages")
NOISE = {"accel": 0.001, "gyro": 0.001, "gps": 0.56}


def resolution(values: np.ndarray) -> np.ndarray:
    """Return half a unit in the last place of single floats, the rounding error of the protocol."""
    return np.spacing(np.abs(values).astype(np.float32)).astype(float) / 2


def read(folder: Path) -> sigmaswarm.Drive:
    """Read a drive without warnings, except about gaps of the fixes in outages."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if folder.name.startswith("outages"):
            warnings.filterwarnings("ignore", r".*gps\.csv: \d gaps?,", SigmaswarmWarning)
        return sigmaswarm.read_drive(folder)


def simulated(log: dict, drive: sigmaswarm.Drive) -> np.ndarray:
    """Return the simulator's motion in the drive's frame: x, y, vx, vy, yaw; force and rate in CARLA's axes."""
    by_frame = {int(row[0]): row[1:] for row in log["truth"]}
    first = drive.metadata["carla"]["first_frame"]
    return np.array([by_frame[first + i] for i in range(len(drive.imu))])


def check_truth(drive: sigmaswarm.Drive, was: np.ndarray) -> None:
    """Check that the truth equals the simulator's motion to the last bit of the protocol."""
    truth = drive.truth
    assert truth is not None
    np.testing.assert_array_equal(truth.time, np.round(np.arange(len(was)) * 0.01, 6))
    np.testing.assert_array_equal(drive.imu.time, truth.time)
    for told, true in zip((truth.x, truth.y, truth.vx, truth.vy), was.T, strict=False):
        assert np.all(np.abs(told - true) <= resolution(true))
    off = np.degrees(np.angle(np.exp(1j * (truth.theta - was[:, 4]))))
    assert np.all(np.abs(off) <= resolution(np.full(len(off), 180.0)) + 1e-12)
    assert np.all((truth.theta > -np.pi) & (truth.theta <= np.pi))


def check_sensors(drive: sigmaswarm.Drive, was: np.ndarray) -> None:
    """Check that sensor values are the simulator's, in the package's axes, plus the specified noise."""
    imu, gps = drive.imu, drive.gps
    fx, fy, fz, p, q, r = was[:, 5:].T
    force = np.array([imu.ax - fx, imu.ay + fy, imu.az - fz])
    rate = np.array([imu.gx + p, imu.gy - q, imu.gz + r]).T - drive.metadata["imu_noise"]["gyro_bias"]
    assert force.std(axis=1) == pytest.approx(3 * [NOISE["accel"]], rel=0.1)
    assert rate.std(axis=0) == pytest.approx(3 * [NOISE["gyro"]], rel=0.1)
    assert np.all(np.abs(force.mean(axis=1)) < 5 * NOISE["accel"] / np.sqrt(len(imu)))
    assert np.all(np.abs(rate.mean(axis=0)) < 5 * NOISE["gyro"] / np.sqrt(len(imu)))
    steps = np.round(gps.time / 0.2)
    np.testing.assert_allclose(gps.time, 0.2 * steps, atol=1e-9)
    at = np.round(gps.time * 100).astype(int)
    off = np.array([gps.x - was[at, 0], gps.y - was[at, 1]])
    assert off.std(axis=1) == pytest.approx(2 * [NOISE["gps"]], rel=0.3)
    assert np.all(np.abs(off.mean(axis=1)) < 5 * NOISE["gps"] / np.sqrt(len(gps)))


def check_achieved(drive: sigmaswarm.Drive) -> None:
    """Check with the truth alone that the maneuver is the requested one."""
    truth, about = drive.truth, drive.metadata
    assert truth is not None
    speed = np.hypot(truth.vx, truth.vy)
    assert speed[:100].max() < 0.01  # 1 s of standstill
    assert np.hypot(truth.x - truth.x[0], truth.y - truth.y[0])[speed > 5.0].max() > 30.0
    yaw, told = np.unwrap(truth.theta), about["achieved"]
    name = about["scenario"]["maneuver"]
    if name == "cruise":
        steady = speed > 0.98 * about["target"]["speed_kmh"] / 3.6
        assert np.sum(speed[steady]) * 0.01 > 480.0
        assert np.ptp(yaw) < 0.03
        assert told["distance_m"] == pytest.approx(500.0, abs=1.0)
    elif name == "turns":
        assert told["left_deg"] == pytest.approx(90.0, abs=4.0)
        assert told["right_deg"] == pytest.approx(-90.0, abs=4.0)
        assert np.degrees(np.ptp(yaw)) == pytest.approx(90.0, abs=6.0)
        assert abs(yaw[-1] - yaw[0]) < 0.1
    elif name == "outages":
        gaps = np.sort(np.diff(drive.gps.time))[-2:]
        assert np.all((gaps > 3.0) & (gaps <= 5.001))
        assert sorted(gaps) == pytest.approx(sorted([told["outage_1_s"], told["outage_2_s"]]))
    else:
        fast = (60.0 if name == "accelerate" else 50.0) / 3.6
        beyond = np.flatnonzero(speed >= fast)
        rest = np.flatnonzero(speed <= 0.1)
        rest = rest[rest < beyond[0]][-1:] if name == "accelerate" else rest[rest > beyond[-1]][:1]
        took = 0.01 * abs(rest[0] - (beyond[0] if name == "accelerate" else beyond[-1]))
        assert told["time_s"] == pytest.approx(took, abs=0.02)
        assert took < (5.2 if name == "accelerate" else 2.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("version", "maneuvers"),
    [("0.9.16", ALL), ("0.9.14", ALL), ("0.9.15", ("turns", "brake"))],
)
def test_from_the_server_to_a_tuned_filter(version: str, maneuvers: tuple[str, ...], tmp_path: Path):
    out = tmp_path / "drives"
    with stand_in(tmp_path, version) as server:
        done = record(
            server.port, out, "--environment", "clear", "--runs", 1, "--maneuver", *maneuvers, version=version
        )
    assert done.returncode == 0, done.stderr
    assert f"recorded {len(maneuvers)} drive" in done.stdout
    drives = [read(out / f"{name}-clear-00") for name in maneuvers]
    for drive in drives:
        was = simulated(server.log, drive)
        check_truth(drive, was)
        check_sensors(drive, was)
        check_achieved(drive)
        assert drive.metadata["imu_place"]["ahead_of_rear_axle_m"] == pytest.approx(1.380, abs=1e-3)
        assert drive.metadata["source"] == f"CARLA {version}"
        assert (drive.gps.std_x == NOISE["gps"]).all()
        assert drive.metadata["carla"]["velocity_against_positions_ms"] < 0.01
    # The world is restored.
    assert server.log["settings"][:6] == DEFAULTS[:6]
    assert server.log["weather"] == [10.0] + 13 * [0.0]
    assert server.log["actors"] == []
    # Each sensor of each run has a different seed.
    seeds = [a["noise_seed"] for a in server.log["attributes"] if "noise_seed" in a]
    assert len(set(seeds)) == len(seeds) == 2 * len(maneuvers)
    journal = json.loads((out / "recording.json").read_text())
    physics = journal["physics"]["clear"]
    assert physics["mass"] == 1845.0
    assert physics["steering_curve"] == [{"x": 0.0, "y": 1.0}, {"x": 200.0, "y": 1.0}]
    assert [wheel["max_brake_torque"] for wheel in physics["wheels"]] == 4 * [1400.0]
    assert journal["geodesy"]["latitude_grows_south"] == (version == "0.9.16")

    for drive in drives:
        found = sigmaswarm.diagnose(drive).findings
        assert not [f for f in found if f.severity == "serious"], (drive.name, found)
    tuning = sigmaswarm.tune(drives[1:], objective="truth-pose", particles=8, generations=3)
    scores = sigmaswarm.evaluate(drives[:1], tuning.parameters)
    assert np.isfinite(tuning.cost)
    (on_unseen,) = scores.drives.values()
    # A few seconds of braking are little data, but the tuned filter must be better than the IMU alone.
    assert on_unseen.scores["tuned"].position_rmse < 0.5 * on_unseen.scores["imu_only"].position_rmse


def test_without_noise_the_sensors_are_the_simulators(tmp_path: Path):
    quiet = ("--accel-noise", 0, "--gyro-noise", 0, "--gyro-bias", 0, "--gps-noise", 0)
    # The first samples are missing, as can happen after listen(), and the next one is late; the drive then begins later
    # than the oldest data.
    with stand_in(tmp_path, deaf=2, late=["imu", 3, 0.3]) as server:
        done = record(
            server.port, tmp_path / "d", "--maneuver", "turns", "--environment", "rain", "--runs", 1, *quiet
        )
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "d" / "turns-rain-00"
    drive = read(folder)
    was = simulated(server.log, drive)
    check_truth(drive, was)
    imu = drive.imu
    assert imu.az is not None
    fx, fy, fz, _, _, r = was[:, 5:].T
    for told, true in ((imu.ax, fx), (-imu.ay, fy), (imu.az, fz), (-imu.gz, r)):
        assert np.all(np.abs(told - true) <= resolution(true))
    np.testing.assert_allclose(np.diff(drive.gps.time), 0.2, atol=1e-9)
    at = np.round(drive.gps.time * 100).astype(int)
    np.testing.assert_allclose(drive.gps.x, was[at, 0], atol=1e-5)
    np.testing.assert_allclose(drive.gps.y, was[at, 1], atol=1e-5)
    # The columns are those of `simulate`.
    sigmaswarm.write_drive(sigmaswarm.simulate("turns", "rain", gps="carla"), tmp_path / "s")
    for file, left_out in (("imu.csv", []), ("gps.csv", ["std_x", "std_y"]), ("truth.csv", [])):
        columns = pl.read_csv(tmp_path / "s" / file).columns
        assert pl.read_csv(folder / file).columns == [c for c in columns if c not in left_out]
    about = tomllib.loads((folder / "drive.toml").read_text())
    assert not {"accel_noise_density", "gyro_noise_density", "gps_std_m"} & set(about)
    assert about["carla"]["tire_friction"] == pytest.approx(3.5 * 0.65 / 0.85, rel=1e-6)


@pytest.mark.long
def test_a_sweep_of_the_brakes_measures_the_friction_and_uses_it(tmp_path: Path):
    out = tmp_path / "d"
    with stand_in(tmp_path, grip=0.5) as server:
        done = record(
            server.port, out, "--brake-sweep", "--maneuver", "brake", "--environment", "slippery", "--runs", 1
        )
    assert done.returncode == 0, done.stderr
    for tire, friction in json.loads((out / "recording.json").read_text())["friction"]:
        assert friction == pytest.approx(0.5 * tire / 3.5, rel=0.06)
    drive = read(out / "brake-slippery-00")
    assert drive.metadata["carla"]["tire_friction"] == pytest.approx(3.5 * 0.25 / 0.5, rel=0.06)
    assert drive.truth is not None
    speed = np.hypot(drive.truth.vx, drive.truth.vy)
    assert -np.diff(speed[::10]).min() / 0.1 == pytest.approx(0.9 * 0.25 * 9.81, rel=0.15)
