from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.gps import GPS_GRADES, HEADING_GRADES, GpsGrade, degrade, measure_gps
from sigmaswarm.simulation.motion import Motion
from sigmaswarm.simulation.scenarios import simulate

COUNT = 50_000


def moving(count=COUNT, speed=10.0, interval=0.2):
    """Return the motion of a car that drives east at a constant speed."""
    time = np.arange(count) * interval
    zero = np.zeros(count)
    velocity = np.column_stack([zero + speed, zero, zero])
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    return time, Motion(velocity * time[:, None], velocity, rotation, zero, velocity, velocity)


def fixes(grade, outages=(), count=COUNT, **how):
    time, motion = moving(count, **how)
    return measure_gps(time, motion, grade, np.random.default_rng(2), list(outages)), motion


@pytest.mark.parametrize("name", GPS_GRADES)
def test_errors_have_the_stated_size(name):
    grade = GPS_GRADES[name]
    gps, motion = fixes(grade, speed=0.0, interval=5.0)  # 70 hours, since errors last a minute
    for error in (gps.x - motion.position[:, 0], gps.y):
        assert error.std() == pytest.approx(grade.std, rel=0.10, abs=1e-6)
    if grade.std == 0.0:  # a standard deviation of 0 is not written
        assert gps.std_x is None
    else:
        assert gps.std_x is not None
        np.testing.assert_allclose(gps.std_x, grade.std)


def test_the_autocorrelation_separates_white_and_correlated_errors():
    grade = GPS_GRADES["ublox-m8"]
    error = fixes(grade)[0].y
    lag = round(grade.markov_time / 0.2)
    covariance = float(np.mean(error[lag:] * error[:-lag]))
    assert covariance == pytest.approx(grade.markov_std**2 * np.exp(-1), rel=0.25)
    assert np.diff(error).std() == pytest.approx(np.sqrt(2) * grade.white_std, rel=0.05)


def test_only_receivers_with_a_velocity_grade_report_velocity():
    gps, _ = fixes(GpsGrade("test", 1.0, velocity_std=0.05))
    assert gps.speed is not None and gps.course is not None
    assert gps.speed.mean() == pytest.approx(10.0, abs=0.01)
    assert gps.course.std() == pytest.approx(0.005, rel=0.05)
    assert fixes(GpsGrade("test", 1.0), count=9)[0].speed is None


def test_lost_fixes_and_outages_are_missing():
    gps, _ = fixes(GpsGrade("test", 1.0, loss=0.1), outages=[(100.0, 104.0)])
    assert len(gps) == pytest.approx(0.9 * COUNT, rel=0.02)
    assert not ((gps.time >= 100) & (gps.time < 104)).any()


def test_carlas_noise_is_white_in_degrees_and_converted_by_its_geodesy():
    gps, motion = fixes(GPS_GRADES["carla"], count=2000)
    plain, _ = fixes(replace(GPS_GRADES["carla"], carla=False), count=2000)
    # At the equator, a degree has the same length in both directions, and the distortion within 4 km is small.
    np.testing.assert_allclose(gps.x, plain.x, atol=1e-5)
    np.testing.assert_allclose(gps.y, plain.y, atol=1e-5)
    assert np.abs(gps.x - motion.position[:, 0]).max() > 1.0


def test_degradation_multiplies_all_errors():
    worse = degrade(GPS_GRADES["ublox-m8"], 2.0)
    assert worse.std == pytest.approx(4.2)
    assert worse.velocity_std == pytest.approx(0.1)


def test_the_heading_of_two_antennas_has_the_noise_of_its_grade():
    mounted = replace(HEADING_GRADES["dual-antenna"], mounting=0.1)
    drives = {of: simulate("turns", heading=of) for of in (None, "ideal", "dual-antenna", mounted)}
    plain = drives[None]
    for of, drive in drives.items():
        assert plain.truth is not None
        np.testing.assert_array_equal(drive.gps.x, plain.gps.x)
        np.testing.assert_array_equal(drive.imu.gz, plain.imu.gz)
        if of is None:
            assert drive.gps.heading is None and "heading" not in drive.metadata
            continue
        assert drive.gps.heading is not None
        theta = np.interp(drive.gps.time, plain.truth.time, plain.truth.theta)
        off = np.degrees(wrap_angle(drive.gps.heading - theta))
        if of == "ideal":
            assert np.abs(off).max() < 0.05 and drive.gps.std_heading is None
        else:
            assert 0.2 < off.std() < 0.5 and abs(off.mean() - (of is mounted) * np.degrees(0.1)) < 0.6
            np.testing.assert_allclose(drive.gps.std_heading, np.radians(0.4))
