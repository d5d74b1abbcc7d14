"""Truth with standard deviations: scores with weights, compared with loops, and gaps of truth."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from scoring.variants import DRIVE
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.gaps import share_known
from sigmaswarm.errors import DriveError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.evaluation import evaluate
from sigmaswarm.scoring.remarks import partly_scored
from sigmaswarm.scoring.score import HEADING_FLOOR, POSITION_FLOOR, score_estimate, score_raw_gps
from sigmaswarm.scoring.targets import outage_windows

SET = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))


def with_truth_noise(drive: Drive, *gaps: tuple[float, float]) -> Drive:
    """Return the drive with truth whose standard deviations vary from 0.02 to 2 m, and with gaps of truth."""
    t = drive.truth.time
    truth = replace(
        drive.truth,
        std_x=0.02 + 2 * np.sin(t) ** 2,
        std_y=0.02 + np.cos(t) ** 2,
        std_theta=0.001 + 0.02 * np.sin(0.7 * t) ** 2,
    )
    for start, end in gaps:
        truth = truth.select((truth.time < start) | (truth.time > end))
    return replace(drive, truth=truth)


DOUBTED = with_truth_noise(DRIVE, (9.0, 11.0))


def by_loop(truth: Truth, estimate: Estimate) -> tuple[float, float, float]:
    """Return weighted position and heading RMSE, m and rad, and mean NEES, computed in a loop."""
    position = heading = nees = counts = turned = 0.0
    n = 0
    for j, t in enumerate(truth.time):
        if not estimate.initial.time <= t <= estimate.time[-1]:
            continue
        i = int(np.flatnonzero(estimate.time == t)[0]) if t in estimate.time else None
        if i is None:
            continue
        e = estimate.mean[i, :2] - (truth.x[j], truth.y[j])
        variance = (truth.std_x[j] ** 2 + truth.std_y[j] ** 2) / 2
        w = POSITION_FLOOR**2 / (variance + POSITION_FLOOR**2)
        position, counts = position + w * (e @ e), counts + w
        p = estimate.covariance[i, :2, :2] + np.diag([truth.std_x[j] ** 2, truth.std_y[j] ** 2])
        nees, n = nees + e @ np.linalg.solve(p, e), n + 1
        if math.hypot(truth.vx[j], truth.vy[j]) > 2.0:
            d = estimate.mean[i, 4] - truth.theta[j]
            w = HEADING_FLOOR**2 / (truth.std_theta[j] ** 2 + HEADING_FLOOR**2)
            heading, turned = heading + w * math.atan2(math.sin(d), math.cos(d)) ** 2, turned + w
    return math.sqrt(position / counts), math.sqrt(heading / turned), nees / n


def test_truth_is_weighted_by_its_standard_deviation_in_both_implementations():
    estimate = run_filter(DOUBTED, SET)
    expected = by_loop(DOUBTED.truth, estimate)
    score = score_estimate(DOUBTED, estimate)
    assert (score.position_rmse, score.heading_rmse) == pytest.approx(expected[:2], rel=1e-9)
    scores = BatchScorer.prepare([DOUBTED]).scores([SET])
    found = (scores.position_rmse[0, 0], scores.heading_rmse[0, 0], scores.mean_nees[0, 0])
    assert found == pytest.approx(expected, rel=1e-9)
    exact = BatchScorer.prepare([replace(DOUBTED, truth=DRIVE.truth)]).scores([SET])
    assert abs(exact.position_rmse[0, 0] / found[0] - 1) > 1e-3  # the weights have an effect


def test_equal_standard_deviations_change_no_error():
    same = replace(
        DRIVE,
        truth=replace(
            DRIVE.truth, std_x=np.full(len(DRIVE.truth), 0.4), std_y=np.full(len(DRIVE.truth), 0.4)
        ),
    )
    one, other = (BatchScorer.prepare([drive]).scores([SET]) for drive in (DRIVE, same))
    assert one.position_rmse[0, 0] == pytest.approx(other.position_rmse[0, 0], rel=1e-12)
    assert one.heading_rmse[0, 0] == pytest.approx(other.heading_rmse[0, 0], rel=1e-12)
    assert other.mean_nees[0, 0] < one.mean_nees[0, 0]


def test_gaps_are_not_scored():
    ready = initial_state(DOUBTED)
    for seed in range(40):
        ends = outage_windows(DOUBTED, ready, length=2.0, seed=seed)[:, 1]
        assert not np.any((ends > 9.0) & (ends < 11.0))
    far = replace(
        DOUBTED, gps=replace(DOUBTED.gps, x=DOUBTED.gps.x + 1e4 * (abs(DOUBTED.gps.time - 10) < 0.9))
    )
    assert score_raw_gps(far, ready).position_rmse < 100
    whole = with_truth_noise(DRIVE)
    assert share_known(whole.truth, 0.0, float(DRIVE.imu.time[-1])) > 0.99
    assert share_known(DOUBTED.truth, 5.0, 15.0) == pytest.approx(0.8, abs=0.01)


def test_the_scored_fraction_of_a_drive_is_reported():
    found = evaluate(DOUBTED, SET)
    record = next(iter(found.drives.values())).record
    start = initial_state(DOUBTED).time
    length = DOUBTED.imu.time[-1] - start
    assert record.truth_share == pytest.approx(1 - 2.0 / length, abs=0.01)
    said = partly_scored([record])
    assert f"{record.truth_share:.0%} of the time" in said[0]
    assert not partly_scored([next(iter(evaluate(DRIVE, SET).drives.values())).record])
    assert json.dumps(found.to_dict(), allow_nan=False)


def test_standard_deviations_of_truth_are_part_of_a_drive_s_identity():
    other = replace(DOUBTED, truth=replace(DOUBTED.truth, std_y=2 * DOUBTED.truth.std_y))
    assert len({fingerprint(drive) for drive in (DOUBTED, other, replace(DOUBTED, name="copy"))}) == 2


def test_both_axes_need_a_standard_deviation_or_none():
    with pytest.raises(DriveError, match="std_x and std_y only together"):
        replace(DRIVE.truth, std_x=np.ones(len(DRIVE.truth)))
