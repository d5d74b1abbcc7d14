"""The sums of the compiled filters, compared with the definitions over whole trajectories."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace

import numpy as np
import pytest

from scoring.variants import VARIANTS, resampled
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.filters.models import THETA, gps_position, planar5
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, PAPER
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.textbook import SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.scoring.targets import outage_windows
from sigmaswarm.tuning.space import search_space
from support import hide_fixes, make_drive, timeline_of

SPACE = search_space("planar5", "log10")
SETS = [
    DEFAULTS,
    PAPER,
    FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0)),
    *SPACE.decode(np.random.default_rng(0).uniform(SPACE.low, SPACE.high, (17, 10))),
]
NUMBERS = ("position_rmse", "heading_rmse", "outage_drift", "fix_rmse", "mean_nis")


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_compiled_sums_give_the_scores_of_the_trajectories(variant: str):
    drive = VARIANTS[variant]
    scores = BatchScorer.prepare([drive]).scores(SETS)
    for i, parameters in enumerate(SETS):
        expected = score_estimate(drive, run_filter(drive, parameters))
        assert scores.position_rmse[i, 0] == pytest.approx(expected.position_rmse, rel=1e-9)
        assert scores.heading_rmse[i, 0] == pytest.approx(expected.heading_rmse, rel=1e-9)
    assert not scores.failed.any()
    assert np.isnan(scores.outage_drift).all()


def drift_by_hand(drive: Drive, parameters: FilterParameters, windows: np.ndarray) -> float:
    """Run without the fixes in the windows; return the RMS position error at the ends of the windows."""
    estimate = run_filter(hide_fixes(drive, windows), parameters, initial=initial_state(drive))
    squares = []
    for end in windows[:, 1]:
        i = int(np.flatnonzero(estimate.time == end)[0])
        x, y = (
            np.interp(end, drive.truth.time, drive.truth.x),
            np.interp(end, drive.truth.time, drive.truth.y),
        )
        squares.append((estimate.mean[i, 0] - x) ** 2 + (estimate.mean[i, 1] - y) ** 2)
    return math.sqrt(sum(squares) / len(squares))


@pytest.mark.parametrize(("length", "seed"), [(5.0, 0), (3.0, 1)])
def test_outage_drift_is_the_error_at_the_ends_of_the_windows(length: float, seed: int):
    drive = make_drive(duration=60.0, seed=3, jitter=0.2)
    scores = BatchScorer.prepare(
        [drive], PassOptions(outages=True, outage_length=length, outage_seed=seed)
    ).scores(SETS)
    windows = outage_windows(drive, initial_state(drive), length=length, seed=seed)
    assert len(windows) >= 2
    for i, parameters in enumerate(SETS):
        assert scores.outage_drift[i, 0] == pytest.approx(drift_by_hand(drive, parameters, windows), rel=1e-9)
    # the tracking scores are those of the run with all fixes
    np.testing.assert_array_equal(
        scores.position_rmse, BatchScorer.prepare([drive]).scores(SETS).position_rmse
    )


@pytest.mark.parametrize("seed", range(8))
def test_outage_windows_satisfy_their_rules(seed: int):
    drive = make_drive(duration=80.0, seed=seed, jitter=0.3)
    start = initial_state(drive)
    windows = outage_windows(drive, start, length=5.0, seed=seed)
    assert len(windows) >= 2
    np.testing.assert_allclose(windows[:, 1] - windows[:, 0], 5.0, atol=1e-9)
    assert windows[0, 0] >= start.time + 10.0
    assert np.all(windows[1:, 0] - windows[:-1, 1] >= 5.0 - 1e-9)
    assert np.isin(windows[:, 1], drive.imu.time).all()
    np.testing.assert_array_equal(outage_windows(drive, start, length=5.0, seed=seed), windows)
    assert not np.array_equal(outage_windows(drive, start, length=5.0, seed=seed + 1), windows)


def ends_of(drive: Drive) -> np.ndarray:
    start = initial_state(drive)
    ends = [outage_windows(drive, start, length=5.0, seed=seed)[:, 1] for seed in range(300)]
    return np.concatenate(ends)


def test_outages_end_where_truth_is_known():
    """Outside its time range, truth would be extrapolated as constant."""
    drive = make_drive(duration=60.0, imu_rate=4.0)
    for first, last in [(30.0, 60.0), (0.0, 35.05), (25.0, 48.0)]:
        known = replace(
            drive, truth=drive.truth.select((drive.truth.time >= first) & (drive.truth.time <= last))
        )
        between_samples = replace(known, truth=resampled(known.truth, known.truth.time[:-1:3] + 0.2))
        for d in (known, between_samples):
            ends = ends_of(d)
            assert len(ends)
            assert ends.min() >= d.truth.time[0]
            assert ends.max() <= d.truth.time[-1]


def test_without_truth_outages_end_within_the_time_of_the_fixes():
    drive = make_drive(duration=60.0, truth=False)
    short = replace(drive, gps=drive.gps.select(drive.gps.time < 40.0))
    assert ends_of(short).max() <= short.gps.time[-1]


def test_without_truth_the_drift_is_relative_to_the_hidden_fixes():
    drive = make_drive(duration=60.0, truth=False)
    score = BatchScorer.prepare([drive], PassOptions(outages=True)).scores(SETS[2:3])[0, 0]
    start = initial_state(drive)
    windows = outage_windows(drive, start, length=5.0, seed=0)
    estimate = run_filter(hide_fixes(drive, windows), SETS[2], initial=start)
    ends = windows[:, 1]
    squares = [
        (np.interp(ends, estimate.time, estimate.mean[:, i]) - np.interp(ends, drive.gps.time, z)) ** 2
        for i, z in enumerate((drive.gps.x, drive.gps.y))
    ]
    assert score.outage_drift == pytest.approx(math.sqrt(np.mean(np.sum(squares, axis=0))), rel=1e-9)
    assert math.isnan(score.position_rmse)
    assert not score.failed


def test_a_drive_too_short_for_an_outage_has_no_drift():
    scores = BatchScorer.prepare([make_drive(duration=18.0)], PassOptions(outages=True)).scores(SETS[:2])
    assert np.isnan(scores.outage_drift).all()
    assert not scores.failed.any()


# --- Scores at the fixes -----------------------------------------------------------------------------------


def at_the_fixes(drive: Drive, p: FilterParameters) -> tuple[list[float], list[float]]:
    """Return the squared residual after each fix and the NIS before it, with the textbook filter."""
    start = initial_state(drive)
    line = timeline_of(drive, start.time)
    points = SigmaPoints(p.alpha, p.beta, p.kappa, first=(THETA,))
    ukf = UnscentedKalmanFilter(
        planar5, gps_position(), start.mean, start.covariance, points, angles=(THETA,)
    )
    fixes = iter(line.fixes)
    squares, nis = [], []
    for k, dt in enumerate(line.dt):
        ukf.predict(
            dt, np.array([line.ax[k], line.ay[k], line.gz[k]]), np.diag(p.process_noise) * line.q_scale[k]
        )
        if line.updates[k]:
            z = next(fixes)[:2]
            seen = ukf.update(z, np.diag(p.measurement_noise))
            squares.append(float(np.sum((z - ukf.mean[:2]) ** 2)))
            nis.append(seen.nis)
    return squares, nis


CALM = [
    FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 0.5)),
    FilterParameters(0.9, 1.0, 3.0, (1e-4, 1e-2, 1e-2, 1e-3, 1e-5), (0.01, 4.0)),
]


@pytest.mark.parametrize("parameters", CALM)
def test_residual_and_nis_agree_with_the_textbook(parameters: FilterParameters):
    drive = make_drive(duration=14.0, seed=6, jitter=0.2)
    squares, nis = at_the_fixes(drive, parameters)
    score = BatchScorer.prepare([drive]).scores([parameters])[0, 0]
    assert len(squares) > 40
    assert score.fix_rmse == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-7)
    assert score.mean_nis == pytest.approx(np.mean(nis), rel=1e-7)


def test_residuals_follow_from_the_trajectory_if_fixes_are_at_samples():
    drive = make_drive(duration=20.0, seed=2)
    i = np.arange(30, 2000, 20)
    noise = np.random.default_rng(0).standard_normal((2, len(i)))
    t = drive.truth
    drive = replace(drive, gps=Gps(time=t.time[i], x=t.x[i] + noise[0], y=t.y[i] + noise[1]))
    scores = BatchScorer.prepare([drive]).scores(SETS)
    for row, parameters in enumerate(SETS):
        estimate = run_filter(drive, parameters)
        fixes = drive.gps.select(drive.gps.time > estimate.initial.time)
        at = np.searchsorted(estimate.time, fixes.time)
        residual = np.hypot(fixes.x - estimate.mean[at, 0], fixes.y - estimate.mean[at, 1])
        assert scores.fix_rmse[row, 0] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6, abs=1e-9)


def test_a_correct_covariance_has_a_mean_nis_of_two():
    """The synthetic IMU is exact, so the filter is consistent with almost no Q and with the true R."""
    right = FilterParameters(0.5, 2.0, 0.0, (1e-6, 1e-6, 1e-6, 1e-6, 1e-9), (1.0, 1.0))
    drives = [make_drive(duration=60.0, seed=s) for s in range(6)]
    scores = BatchScorer.prepare(drives).scores([right, replace(right, measurement_noise=(4.0, 4.0))])
    n = sum(len(timeline_of(d, initial_state(d).time).fixes) for d in drives)
    assert scores.mean_nis[0].mean() == pytest.approx(2.0, abs=5 * math.sqrt(4 / n))
    assert scores.mean_nis[1].mean() < 0.8


# --- Many sets and drives ----------------------------------------------------------------------------------


def test_neither_other_sets_nor_workers_change_a_bit():
    drives = [make_drive(duration=25.0, seed=s, name=f"d{s}") for s in range(3)]
    replayer = BatchScorer.prepare(drives, PassOptions(outages=True))
    alone = [replayer.scores([p]) for p in SETS]
    together = replayer.scores(SETS)
    backwards = replayer.scores(SETS[::-1])
    with ThreadPoolExecutor(3) as pool:
        threaded = replayer.scores(SETS, pool)
    for name in NUMBERS:
        all_at_once = getattr(together, name)
        np.testing.assert_array_equal(all_at_once, np.vstack([getattr(a, name) for a in alone]))
        np.testing.assert_array_equal(all_at_once, getattr(backwards, name)[::-1])
        np.testing.assert_array_equal(all_at_once, getattr(threaded, name))
        for j, drive in enumerate(drives):
            np.testing.assert_array_equal(
                all_at_once[:, j : j + 1],
                getattr(BatchScorer.prepare([drive], PassOptions(outages=True)).scores(SETS), name),
            )


def test_a_failing_set_is_marked_and_changes_no_bit_of_the_others():
    drive = make_drive(duration=25.0)
    bad = replace(DEFAULTS, process_noise=(1.0, 1.0, -10.0, 1.0, 1.0))
    sets = SETS[:4]
    replayer = BatchScorer.prepare([drive], PassOptions(outages=True))
    clean, mixed = replayer.scores(sets), replayer.scores([sets[0], bad, *sets[1:], bad])
    assert mixed.failed[:, 0].tolist() == [False, True, False, False, False, True]
    for name in NUMBERS:
        np.testing.assert_array_equal(getattr(mixed, name)[[0, 2, 3, 4]], getattr(clean, name))
    assert math.isnan(mixed[1, 0].position_rmse)
    assert mixed[1, 0].failed


def test_filters_do_not_read_truth():
    drive = make_drive(duration=20.0)
    with_truth, without = (run_filter(d, DEFAULTS) for d in (drive, replace(drive, truth=None)))
    for name in ("time", "mean", "covariance"):
        assert getattr(with_truth, name).tobytes() == getattr(without, name).tobytes()
    # scores at the fixes do not depend on truth either
    scores = [BatchScorer.prepare([d]).scores(SETS) for d in (drive, replace(drive, truth=None))]
    np.testing.assert_array_equal(scores[0].fix_rmse, scores[1].fix_rmse)
    np.testing.assert_array_equal(scores[0].mean_nis, scores[1].mean_nis)


def test_a_subset_gives_the_scores_of_its_drives():
    drives = [make_drive(duration=30.0, seed=seed, name=f"d{seed}") for seed in range(4)]
    whole = BatchScorer.prepare(drives, PassOptions(outages=True, forecasts=True))
    assert whole.steps.sum() > 0  # computes the cached number of steps before the subset is taken
    part, alone = (
        whole.subset([3, 1]),
        BatchScorer.prepare([drives[3], drives[1]], PassOptions(outages=True, forecasts=True)),
    )
    assert [drive.name for drive in part.drives] == ["d3", "d1"]
    np.testing.assert_array_equal(part.steps, alone.steps)
    assert len(whole.steps) == 4
    found, wanted = part.scores([DEFAULTS]), alone.scores([DEFAULTS])
    for field in fields(found):
        name = field.name
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
