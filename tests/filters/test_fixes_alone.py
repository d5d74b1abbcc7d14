"""The filter without IMU, compared with FilterPy, and its noise parameters with the data to which they are fitted."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from sigmaswarm import baseline, simulate
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.filter_run import join_chunks
from sigmaswarm.filters.fixes_alone import UNKNOWN_SPEED, FixesAlone, MotionNoise, fit_noise, fitted_noise
from sigmaswarm.scoring.drifts import OutageDrifts
from sigmaswarm.scoring.evaluation import evaluate
from sigmaswarm.scoring.targets import outage_pass, tracking_pass
from support import make_drive, quickly

UNSTATED = 2.1**2
NOISE = MotionNoise(acceleration=0.7, fix=0.3)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", duration=60, gps="white-1m")


@pytest.mark.parametrize("stated", quickly([(True,), (False,)], lambda stated: stated))
def test_it_agrees_with_filterpy(drive: Drive, stated: bool):
    """Compare position, velocity and covariance at every IMU sample, between fixes and at fixes."""
    gps = drive.gps if stated else replace(drive.gps, std_x=None, std_y=None)
    ready = PreparedDrive(replace(drive, gps=gps))
    drive_pass = tracking_pass(ready)
    found = join_chunks(FixesAlone(drive_pass, NOISE))
    line, start = drive_pass.timeline, drive_pass.initial
    kf = KalmanFilter(dim_x=4, dim_z=2)
    kf.x = np.array(start.mean[:4])
    r = NOISE.fix * (1.0 if stated else UNSTATED)
    kf.P = np.diag([r, r, UNKNOWN_SPEED**2, UNKNOWN_SPEED**2])
    kf.R, kf.H = r * np.eye(2), np.eye(2, 4)

    def move(to: float) -> None:
        nonlocal now
        t, eye = to - now, np.eye(2)
        kf.F = np.block([[eye, t * eye], [np.zeros((2, 2)), eye]])
        kf.Q = NOISE.acceleration * np.block([[t**3 / 3 * eye, t**2 / 2 * eye], [t**2 / 2 * eye, t * eye]])
        kf.predict()
        now = to

    now, at, theirs = start.time, 0, []
    for time in found.time:
        while at < len(line.fix_time) and line.fix_time[at] <= time:
            move(line.fix_time[at])
            kf.update(line.fixes[at, :2])
            at += 1
        move(time)
        theirs.append([*kf.x, kf.P[0, 0]])
    means, variances = np.split(np.array(theirs), [4], axis=1)
    np.testing.assert_allclose(found.mean[:, :4], means, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found.covariance[:, 0, 0], variances[:, 0], rtol=1e-8)
    np.testing.assert_array_equal(found.mean[:, 4], np.arctan2(found.mean[:, 3], found.mean[:, 2]))
    assert at == len(line.fix_time)


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_the_fit_estimates_the_noise_of_the_fixes(sigma: float):
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 400.0, 0.5)
    v = np.cumsum(rng.normal(0, np.sqrt(0.5 * 0.5), (len(t), 2)), axis=0)
    p = np.cumsum(v * 0.5, axis=0) + rng.normal(0, sigma, (len(t), 2))
    imu = make_drive(duration=400.0, seed=0)
    drive = replace(imu, gps=Gps(t, p[:, 0], p[:, 1]), truth=None)
    found = fit_noise(tracking_pass(PreparedDrive(drive)))
    assert UNSTATED * found.fix == pytest.approx(sigma**2, rel=0.25)
    assert found.acceleration == pytest.approx(0.5, rel=0.5)
    told = np.full(len(t), 2 * sigma)
    stated = replace(drive, gps=replace(drive.gps, std_x=told, std_y=told))
    assert fitted_noise(PreparedDrive(stated)).fix == pytest.approx(0.25, rel=0.25)


def test_the_noise_of_several_drives_is_their_median():
    each = [MotionNoise(0.1, 2.0), MotionNoise(1000.0, 0.5), MotionNoise(0.4, 4.0)]
    found = MotionNoise.typical(each)
    assert (found.acceleration, found.fix) == (pytest.approx(0.4), pytest.approx(2.0))


def test_during_an_outage_the_velocity_is_constant(drive: Drive):
    """Hidden fixes do not change the estimate."""
    drive_pass = outage_pass(PreparedDrive(drive), length=5.0)
    found = join_chunks(FixesAlone(drive_pass, NOISE))
    gaps = np.flatnonzero(np.diff(drive_pass.timeline.fix_time) > 4.5)
    assert len(gaps)
    for i in gaps:
        inside = (found.time > drive_pass.timeline.fix_time[i]) & (
            found.time < drive_pass.timeline.fix_time[i + 1]
        )
        assert np.ptp(found.mean[inside, 2:4], axis=0).max() == 0.0


def test_every_evaluation_contains_it_also_without_truth(drive: Drive):
    parameters = baseline(drive)
    with_truth, blind = evaluate(drive, parameters), evaluate(replace(drive, truth=None), parameters)
    scores = with_truth.scores[drive.name]
    assert scores["fixes_alone"].position_rmse < scores["raw_gps"].position_rmse
    assert blind.value(drive.name, "fixes_alone", "outage_drift_m") > 0
    assert blind.value(drive.name, "fixes_alone", "position_rmse_m") is None


@pytest.mark.long
def test_an_evaluation_uses_the_noise_of_the_training_drives(drive: Drive):
    own, tuned = evaluate(drive, baseline(drive)), evaluate(drive, baseline(drive), fixes_alone=NOISE)
    assert own.setup.fixes_alone is None and tuned.setup.fixes_alone == NOISE
    assert any("are fitted to each drive" in said for said in own.view.explanations())
    assert any("are fitted to the training drives" in said for said in tuned.view.explanations())
    drifts = [each.scores[drive.name]["fixes_alone"].outage_drift for each in (own, tuned)]
    outages = OutageDrifts(PreparedDrive(drive), length=5.0, seed=0)
    outages.run({"tuned": baseline(drive)}, {"alone": partial(FixesAlone, noise=NOISE)})
    assert drifts[1] == outages.drift("alone") != drifts[0]
