"""The definitions of the scores, compared with loops."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from scoring.variants import DRIVE, VARIANTS
from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.scoring.score import PieceErrors, score_estimate, score_raw_gps
from support import make_drive

SET = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))


def turned(a: float, b: float) -> float:
    """Return the difference b - a, wrapped to half a turn."""
    return math.atan2(math.sin(b - a), math.cos(b - a))


def around(truth: Truth, estimate: Estimate) -> Iterator[tuple[int, float, Array, Array]]:
    """Yield the index of each time of truth, and the weight of the later of the two estimates around it."""
    nodes = [(estimate.initial.time, estimate.initial.mean), *zip(estimate.time, estimate.mean, strict=True)]
    at = 0
    for j, t in enumerate(truth.time):
        if not nodes[0][0] <= t <= nodes[-1][0]:
            continue
        while nodes[at + 1][0] < t:
            at += 1
        (t0, a), (t1, b) = nodes[at], nodes[at + 1]
        yield j, (t - t0) / (t1 - t0), a, b


def distances(truth: Truth, estimate: Estimate) -> list[float]:
    """Return the distance between the estimate and truth at each time of truth, m."""
    true = truth.x, truth.y
    return [
        math.hypot(*((1 - w) * a[i] + w * b[i] - true[i][j] for i in (0, 1)))
        for j, w, a, b in around(truth, estimate)
    ]


def by_loop(truth: Truth, estimate: Estimate) -> tuple[float, float]:
    """Return position RMSE (m) and heading RMSE (rad), computed in a loop over the times of truth."""
    position, heading = [], []
    for j, w, a, b in around(truth, estimate):
        x, y = a[0] + w * (b[0] - a[0]), a[1] + w * (b[1] - a[1])
        theta = a[4] + w * turned(a[4], b[4])
        position.append((x - truth.x[j]) ** 2 + (y - truth.y[j]) ** 2)
        if math.sqrt(truth.vx[j] ** 2 + truth.vy[j] ** 2) > 2.0:
            heading.append(turned(truth.theta[j], theta) ** 2)
    return math.sqrt(sum(position) / len(position)), math.sqrt(sum(heading) / len(heading))


@pytest.mark.parametrize("variant", VARIANTS)
def test_position_and_heading_agree_with_a_loop(variant: str):
    drive = VARIANTS[variant]
    estimate = run_filter(drive, SET)
    score = score_estimate(drive, estimate)
    assert (score.position_rmse, score.heading_rmse) == pytest.approx(
        by_loop(drive.truth, estimate), rel=1e-10
    )
    assert not score.failed


@pytest.mark.parametrize("variant", VARIANTS)
def test_quantiles_agree_with_a_loop(variant: str):
    drive = VARIANTS[variant]
    estimate = run_filter(drive, SET)
    off = sorted(distances(drive.truth, estimate))
    expected = [
        off[int(at)] + at % 1 * (off[min(int(at) + 1, len(off) - 1)] - off[int(at)])
        for at in (0.5 * (len(off) - 1), 0.95 * (len(off) - 1))
    ]
    score = score_estimate(drive, estimate)
    assert [score.position_median, score.position_95] == pytest.approx(expected, rel=1e-9)
    pieces = PieceErrors(drive.truth, estimate.initial)
    for first in range(0, len(estimate.time), 777):
        part = slice(first, first + 777)
        pieces.add(estimate.time[part], estimate.mean[part])
    assert (pieces.score.position_median, pieces.score.position_95) == (
        score.position_median,
        score.position_95,
    )


def test_without_errors_there_are_no_quantiles():
    truth = moving_east(10.0)
    pieces = PieceErrors(truth, InitialState(np.zeros(5), np.eye(5), 0.0))
    assert math.isnan(pieces.score.position_95)
    pieces.add(truth.time[1:], np.full((10, 5), np.nan))
    assert math.isnan(pieces.score.position_median)


def moving_east(speed: float, *, n: int = 11) -> Truth:
    time = np.arange(n, dtype=float)
    zero = np.zeros(n)
    return Truth(time, speed * time, zero, zero + speed, zero, zero)


def estimate_of(truth: Truth, *, east: float = 0.0, heading: float = 0.0) -> Estimate:
    mean = np.column_stack([truth.x + east, truth.y, truth.vx, truth.vy, truth.theta + heading])
    initial = InitialState(mean[0], np.eye(5), float(truth.time[0]))
    return Estimate(truth.time[1:], mean[1:], np.empty(0), initial)


def drive_with(truth: Truth | None) -> Drive:
    return replace(DRIVE, truth=truth)


def test_a_constant_error_equals_its_rmse():
    truth = moving_east(10.0)
    score = score_estimate(drive_with(truth), estimate_of(truth, east=-3.0, heading=0.25))
    assert score.position_rmse == pytest.approx(3.0)
    assert score.heading_rmse == pytest.approx(0.25)


def test_states_after_the_pose_have_no_effect():
    truth = moving_east(10.0)
    plain = estimate_of(truth, east=-3.0, heading=0.25)
    larger = replace(plain, mean=np.hstack([plain.mean, np.ones((len(plain.mean), 3))]))
    assert score_estimate(drive_with(truth), larger).position_rmse == pytest.approx(3.0)


def test_heading_errors_at_walking_pace_are_not_counted():
    truth = moving_east(2.0)
    assert math.isnan(score_estimate(drive_with(truth), estimate_of(truth, heading=1.0)).heading_rmse)
    mixed = replace(truth, vx=np.where(truth.time < 5, 0.5, 3.0))
    wrong = estimate_of(mixed)
    wrong.mean[:4, 4] = 1.0  # at low speed
    assert score_estimate(drive_with(mixed), wrong).heading_rmse == 0.0


def test_full_turns_of_the_true_heading_have_no_effect():
    truth = moving_east(10.0)
    around = replace(truth, theta=truth.theta + 6 * np.pi)
    assert score_estimate(drive_with(around), estimate_of(truth, heading=0.1)).heading_rmse == pytest.approx(
        0.1
    )


def test_the_heading_between_two_estimates_is_interpolated_across_pi():
    truth = moving_east(10.0)
    west = replace(truth, theta=np.full(11, np.pi))
    estimate = estimate_of(truth)
    estimate.mean[:, 4] = np.where(np.arange(10) % 2, np.pi - 0.1, -np.pi + 0.1)
    halves = Truth(truth.time[1:-1] + 0.5, *(np.full(9, v) for v in (0.0, 0.0, 10.0, 0.0, np.pi)))
    assert score_estimate(drive_with(halves), estimate).heading_rmse == pytest.approx(0.0, abs=1e-12)
    assert score_estimate(drive_with(west.select(slice(1, None))), estimate).heading_rmse == pytest.approx(
        0.1
    )


def test_without_truth_there_is_no_score():
    score = score_estimate(drive_with(None), estimate_of(moving_east(10.0)))
    assert math.isnan(score.position_rmse)
    assert math.isnan(score.heading_rmse)
    assert math.isnan(score_raw_gps(drive_with(None), initial_state(DRIVE)).position_rmse)


@pytest.mark.parametrize("variant", VARIANTS)
def test_raw_gps_is_scored_at_its_own_times(variant: str):
    drive = VARIANTS[variant]
    start = initial_state(drive)
    squares = []
    for t, x, y in zip(drive.gps.time, drive.gps.x, drive.gps.y, strict=True):
        if t < start.time or not drive.truth.time[0] <= t <= drive.truth.time[-1]:
            continue
        i = int(np.searchsorted(drive.truth.time, t, side="right"))
        i = min(i, len(drive.truth) - 1)
        w = (t - drive.truth.time[i - 1]) / (drive.truth.time[i] - drive.truth.time[i - 1])
        true_x = (1 - w) * drive.truth.x[i - 1] + w * drive.truth.x[i]
        true_y = (1 - w) * drive.truth.y[i - 1] + w * drive.truth.y[i]
        squares.append((x - true_x) ** 2 + (y - true_y) ** 2)
    expected = math.sqrt(sum(squares) / len(squares))
    assert score_raw_gps(drive, start).position_rmse == pytest.approx(expected, rel=1e-12)


def test_raw_gps_with_1_m_noise_has_an_rmse_of_root_two():
    drive = make_drive(duration=400.0, gps_rate=10.0, seed=9)
    assert score_raw_gps(drive, initial_state(drive)).position_rmse == pytest.approx(math.sqrt(2), rel=0.03)
