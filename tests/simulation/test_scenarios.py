import hashlib

import numpy as np
import pytest

from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.simulation import (
    ENVIRONMENTS,
    GPS_GRADES,
    IMU_GRADES,
    MANEUVERS,
    PAPER_MANEUVERS,
    GpsGrade,
    simulate,
    simulate_many,
)
from support import quickly


def same(a, b, *tables):
    columns = {"truth": ("time", "x", "vx", "theta"), "imu": ("time", "ax", "gz"), "gps": ("time", "x", "y")}
    return all(
        np.array_equal(getattr(getattr(a, table), column), getattr(getattr(b, table), column))
        for table in tables
        for column in columns[table]
    )


def digest(folder):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


def test_the_same_seed_gives_the_same_bytes_for_any_number_of_workers(tmp_path):
    def write_to(where):
        return lambda drive: write_drive(drive, where / drive.name)

    conditions = {"maneuvers": ("turns",), "environments": ("rain", "slippery"), "runs": 2}
    first, second = (
        list(simulate_many(**conditions, workers=workers, use=write_to(tmp_path / str(workers)), seed=5))
        for workers in (1, 3)
    )
    assert [f.name for f in first] == [f.name for f in second]
    assert len(set(first)) == 4
    for a, b in zip(first, second, strict=True):
        assert digest(a) == digest(b)


def test_a_written_drive_is_read_with_all_its_metadata(tmp_path):
    drive = simulate("brake", "rain", seed=3)
    back = read_drive(write_drive(drive, tmp_path / "brake"))
    assert same(drive, back, "imu", "gps", "truth")
    assert back.metadata == drive.metadata
    assert back.metadata["target"] == {"speed_kmh": 50.0, "time_s": 2.0}


def test_other_seeds_runs_and_environments_give_other_noise():
    base = simulate("brake")
    others = [simulate("brake", seed=1), simulate("brake", run=1), simulate("brake", "night")]
    assert not any(same(base, other, "gps") for other in others)


def test_changing_a_sensor_does_not_change_the_noise_of_others():
    base = simulate("turns", seed=2)
    other_gps = simulate("turns", seed=2, gps="f9p-rtk", gps_rate=10.0)
    assert same(base, other_gps, "imu", "truth") and not same(base, other_gps, "gps")
    other_imu = simulate("turns", seed=2, imu="mpu-6050", imu_rate=200.0)
    assert same(base, other_imu, "gps")
    assert np.array_equal(base.truth.x, other_imu.truth.x[::2])


@pytest.mark.parametrize("maneuver", MANEUVERS)
@pytest.mark.parametrize(
    "environment", quickly([("clear",), ("slippery",)], lambda where: where == "slippery")
)
def test_every_drive_allows_an_alignment_before_the_maneuver(maneuver, environment):
    drive = simulate(maneuver, environment, duration=60.0 if maneuver == "urban" else None)
    truth = drive.truth
    speed = np.hypot(truth.vx, truth.vy)
    assert speed[0] < 1e-9
    fast = speed >= 5.0
    first_stretch = np.argmax(fast), np.argmax(fast) + np.argmin(fast[np.argmax(fast) :])
    end = first_stretch[1] if first_stretch[1] > first_stretch[0] else len(speed)
    assert speed[first_stretch[0] : end].sum() * 0.01 > 30.0


def test_without_warm_up_a_drive_starts_in_motion():
    drive = simulate("brake", warm_up=False)
    assert np.hypot(drive.truth.vx[0], drive.truth.vy[0]) == pytest.approx(14.2, abs=0.5)
    assert drive.metadata["achieved"]["time_s"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.long
def test_maneuver_drives_are_25_to_30_seconds_long_on_average():
    lengths = [d.duration for d in simulate_many(environments=("clear", "rain"), runs=2)]
    assert 25.0 < np.mean(lengths) < 30.0


def test_clocks_have_jitter_and_increase_strictly():
    drive = simulate("turns", jitter=0.002)
    steps = np.diff(drive.imu.time)
    assert steps.min() > 0
    assert np.diff(drive.imu.time).std() == pytest.approx(0.002 * np.sqrt(2), rel=0.1)
    ideal = simulate("turns", jitter=0.002, imu="ideal", gps="ideal")
    x = np.interp(ideal.gps.time, ideal.truth.time, ideal.truth.x)
    np.testing.assert_allclose(ideal.gps.x, x, atol=1e-3)


def test_ideal_sensors_agree_with_truth_and_latency_and_lever_arm_shift_it():
    ideal = simulate("turns", imu="ideal", gps="ideal")
    truth = ideal.truth
    np.testing.assert_allclose(ideal.gps.x, np.interp(ideal.gps.time, truth.time, truth.x), atol=1e-9)
    yaw = truth.theta[0] + np.concatenate([[0.0], np.cumsum(ideal.imu.gz[1:] + ideal.imu.gz[:-1]) * 0.005])
    np.testing.assert_allclose(yaw, truth.theta, atol=0.02)  # roll and pitch slightly tilt the gyro

    late = simulate("turns", gps=GpsGrade("late", 0.0, latency=0.1)).gps
    np.testing.assert_allclose(late.x, np.interp(late.time - 0.1, truth.time, truth.x), atol=2e-3)
    ahead = simulate("turns", gps=GpsGrade("ahead", 0.0, lever_arm=(1.0, 0.0, 0.0))).gps
    offset = np.column_stack([ahead.x, ahead.y]) - np.column_stack([ideal.gps.x, ideal.gps.y])
    np.testing.assert_allclose(np.hypot(*offset.T), 1.0, atol=0.01)


def test_vibration_affects_the_imu_of_a_moving_car_and_no_other_sensor():
    still, shaken = (simulate("accelerate", vibration=v) for v in (0.0, 1.0))
    assert same(still, shaken, "gps", "truth")
    noise = shaken.imu.ax - still.imu.ax
    speed = np.hypot(still.truth.vx, still.truth.vy)
    assert noise[speed > 5].std() == pytest.approx(0.06 * 10, rel=0.1)  # density times the root of 100 Hz
    assert noise[:50].std() < 0.01


def test_vibration_causes_no_lasting_rotation():
    """The sum of the added roll and pitch rates stays small, since the springs restore the attitude of the body."""
    still, shaken = (simulate("urban", duration=120.0, imu="ideal", vibration=v).imu for v in (0.0, 1.0))
    for axis, density in (("gx", 0.002), ("gy", 0.003)):
        added = getattr(shaken, axis) - getattr(still, axis)
        assert np.diff(added).std() > 0.5 * density * 10 * np.sqrt(2)  # between samples, except during stops
        assert np.abs(np.cumsum(added) * 0.01).max() < np.radians(0.4)


def test_gnss_degradation_is_off_by_default_and_recorded_if_it_is_on():
    plain, worse = (simulate("brake", "rain", gnss_degradation=on) for on in (False, True))
    assert plain.metadata["gps_std_m"] == pytest.approx(2.1)
    assert worse.metadata["gps_std_m"] == pytest.approx(2.1 * ENVIRONMENTS["rain"].gnss_noise_factor)
    assert worse.metadata["scenario"]["gnss_degradation"] is True


def test_clear_night_and_fog_have_the_same_physics():
    physics = [ENVIRONMENTS[name].physics for name in ("clear", "night", "rain", "fog", "slippery")]
    assert physics == ["dry", "dry", "wet", "dry", "snow"]


@pytest.mark.parametrize("imu", IMU_GRADES)
def test_every_imu_grade_can_be_simulated(imu):
    assert simulate("brake", imu=imu).metadata["imu_noise"]["grade"] == imu


@pytest.mark.parametrize("gps", GPS_GRADES)
def test_every_gps_grade_can_be_simulated(gps):
    assert simulate("brake", gps=gps).metadata["gps_noise"]["grade"] == gps


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"maneuver": "drift"}, "no maneuver is called 'drift'"),
        ({"environment": "hail"}, "no environment is called 'hail'"),
        ({"imu": "golden"}, "no IMU grade"),
        ({"gps": "golden"}, "no GPS grade"),
        ({"vehicle": "trabant"}, "no vehicle"),
        ({"terrain": "alps"}, "no terrain is called 'alps'; choose from flat, rolling, hilly"),
        ({"imu_rate": 0.0}, "imu_rate is 0 Hz"),
        ({"gps_rate": 2000.0}, "gps_rate is 2000 Hz"),
        ({"jitter": -1.0}, "jitter"),
        ({"vibration": float("nan")}, "vibration"),
        ({"maneuver": "brake", "duration": 60.0}, "only 'urban'"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_wrong_input_is_rejected_with_one_sentence(options, said):
    with pytest.raises(InputError, match=said):
        simulate(**options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"maneuvers": ("brake", "drift")}, "no maneuver is called 'drift'"),
        ({"environments": ("clear", "hail")}, "no environment is called 'hail'"),
        ({"runs": 0}, "runs is 0"),
        ({"maneuvers": ("brake", "urban"), "duration": 10.0}, "duration is 10 s"),
        ({"maneuvers": ("brake",), "duration": 60.0}, "only 'urban'"),
    ],
)
def test_a_wrong_condition_is_rejected_before_any_drive_is_simulated(options, said):
    with pytest.raises(InputError, match=said):
        list(simulate_many(**options, use=lambda drive: pytest.fail(f"{drive.name} was made")))


def test_omitted_drives_do_not_change_the_others():
    conditions = {"maneuvers": ("brake",), "environments": ("clear",), "runs": 3}
    whole = list(simulate_many(**conditions))
    rest = list(simulate_many(**conditions, leave_out={"brake-clear-01"}))
    assert [drive.name for drive in rest] == ["brake-clear-00", "brake-clear-02"]
    assert all(same(a, b, "imu", "gps", "truth") for a, b in zip(rest, whole[::2], strict=True))


def test_the_paper_has_five_maneuvers():
    assert PAPER_MANEUVERS == ("cruise", "turns", "accelerate", "brake", "outages")
