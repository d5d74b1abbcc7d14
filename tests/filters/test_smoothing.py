"""The smoother, compared with its textbook form and FilterPy's; its statistics, and properties on every drive."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter as FilterPyUkf

from filter_cases import (
    KINDS,
    OPTIONS,
    WEIGHED,
    equipped,
    parameters,
    rough,
    stands_for_all,
    straying,
    two_receivers,
)
from filters.test_consistency import band, draw, model_parameters, runs_needed, start, time_line
from oracles.filterpy_car import upper_root_theta_first
from oracles.smoother import smooth_textbook
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.filters.divergence import CHECK_INTERVAL
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS, planar5
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.filters.run import Estimate, estimates_of, run_filter, whole_pass
from sigmaswarm.filters.smoothing import SmootherRun, smooth
from sigmaswarm.geodesy import wrap_angle
from support import quickly, sparse, timeline_of


@cache
def began() -> InitialState:
    return initial_state(equipped())


def apart(a: Estimate, b: Estimate) -> float:
    """Return the largest difference: of means in standard deviations, of covariances relative to variances."""
    std = np.sqrt(np.diagonal(b.covariance, axis1=1, axis2=2))
    mean = a.mean - b.mean
    mean[:, 4] = wrap_angle(mean[:, 4])
    covariance = np.abs(a.covariance - b.covariance) / (std[:, :, None] * std[:, None, :])
    return max(float(np.max(np.abs(mean) / std)), float(np.max(covariance)))


# --- The textbook form -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(product(("planar5", "planar8"), KINDS, ("plain", "all", "robust")), stands_for_all),
)
def test_the_compiled_smoother_agrees_with_the_textbook(model: str, kind: str, option: str):
    """The closed-form cross-covariance equals that of the sigma points, also where factors enlarge P."""
    if option == "robust" and kind not in ("ukf", "ekf"):
        pytest.skip("robust goes with ukf and ekf")
    p = parameters(model, kind=kind, **(OPTIONS | WEIGHED)[option])
    drive = sparse({"plain": two_receivers, "all": rough, "robust": straying}[option](), 6)
    ours = smooth(drive, p, initial=began(), recover=False)
    # Student's t amplifies rounding errors: see below
    assert apart(ours, smooth_textbook(drive, p, initial=began())) < (1e-8 if option == "robust" else 1e-9)


@pytest.mark.parametrize(
    ("kind", "option"),
    quickly(
        [*product(("ekf", "ukf"), ("all", "robust")), ("strong-tracking-ukf", "all")],
        lambda kind, option: (kind, option) == ("ekf", "all"),
    ),
)
def test_the_compiled_smoother_agrees_with_the_textbook_for_tilted12(kind: str, option: str):
    p = parameters("tilted12", kind=kind, **(OPTIONS | WEIGHED)[option])
    drive = {"all": rough, "robust": straying}[option]()
    drive = sparse(drive, 6 if kind == "ekf" else 16)  # the textbook takes 25 sigma points through each step
    ours = smooth(drive, p, initial=began(), recover=False)
    theirs = smooth_textbook(drive, p, initial=began())
    difference = apart(ours, theirs)
    if option == "robust" and difference >= 1e-8:
        # At one fix of the jump, the weight of Student's t switches between two solutions, which amplifies rounding a
        # thousandfold: a textbook run whose start differs by 4e-16 differs by as much.
        nearly = replace(began(), mean=began().mean * (1 + 4e-16))
        difference /= 1e8 * 4 * apart(smooth_textbook(drive, p, initial=nearly), theirs)
    assert difference < 1e-8
    assert apart(run_filter(drive, p, initial=began(), recover=False), theirs) > 0.1


# --- FilterPy ----------------------------------------------------------------------------------------------


@cache
def coasting() -> tuple[Drive, InitialState]:
    """Return a drive without acceleration or turn, with fixes at IMU samples of constant dt: the model is linear."""
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 20.05, 0.125)  # a power of two, so that all steps are equal
    none = 0 * time
    fix_time = time[4::4]
    fixes = np.cumsum(rng.standard_normal((2, len(fix_time))), axis=1) + 4.0 * fix_time
    covariance = np.diag([1.0, 2.0, 0.5, 0.6, 0.01])
    covariance[0, 2] = covariance[2, 0] = 0.3
    initial = InitialState(np.array([0.0, 0.0, 4.0, 4.0, 0.7]), covariance, 0.0)
    return Drive("coasting", Imu(time, none, none, none), Gps(fix_time, *fixes)), initial


def test_for_a_linear_model_it_agrees_with_filterpy():
    drive, initial = coasting()
    p = FilterParameters(0.5, 2.0, 1.0, (1e-3, 2e-3, 4e-3, 3e-3, 1e-5), (0.5, 0.8))
    theirs = KalmanFilter(5, 2)
    theirs.x, theirs.P = initial.mean.copy(), initial.covariance.copy()
    theirs.F = np.eye(5)
    theirs.F[0, 2] = theirs.F[1, 3] = 0.125
    theirs.H, theirs.Q, theirs.R = np.eye(2, 5), np.diag(p.process_noise), np.diag(p.measurement_noise)
    fixes = dict(zip(drive.gps.time.tolist(), np.column_stack([drive.gps.x, drive.gps.y]), strict=True))
    means, covariances, _, _ = theirs.batch_filter([fixes.get(t) for t in drive.imu.time[1:].tolist()])
    means, covariances, _, _ = theirs.rts_smoother(means, covariances)
    ours = smooth(drive, p, initial=initial, recover=False)
    np.testing.assert_allclose(ours.mean, means, rtol=0, atol=1e-10)
    np.testing.assert_allclose(ours.covariance, covariances, rtol=0, atol=1e-10)


def test_an_unscented_smoother_agrees_with_filterpy_step_by_step():
    drive = equipped()
    drive = replace(drive, metadata={})
    p = parameters("planar5")
    line = timeline_of(drive, began().time)
    ours = smooth(drive, p, initial=began(), recover=False)
    filtered = run_filter(drive, p, initial=began(), recover=False)
    points = MerweScaledSigmaPoints(5, p.alpha, p.beta, p.kappa, sqrt_method=upper_root_theta_first)
    at = np.flatnonzero(line.sampled)
    whole = np.flatnonzero(np.diff(at) == 1)[100:600:7]  # samples without a fix before the next sample
    for k in whole:
        step = at[k + 1]
        u = np.array([line.ax[step], line.ay[step], line.gz[step]])
        theirs = FilterPyUkf(
            5, 2, dt=line.dt[step], hx=None, fx=lambda s, dt, u=u: planar5(s, dt, u), points=points
        )
        theirs.Q = np.diag(p.process_noise) * line.q_scale[step]
        # The inputs of the step: the filter's state before it, and the smoothed state after it.
        near = 2 * np.pi * np.round((filtered.mean[k, 4] - ours.mean[k + 1, 4]) / (2 * np.pi))
        behind = ours.mean[k + 1] + [0, 0, 0, 0, near]
        means, covariances, _ = theirs.rts_smoother(
            np.array([filtered.mean[k], behind]),
            np.array([filtered.covariance[k], ours.covariance[k + 1]]),
        )
        np.testing.assert_allclose(wrap_angle(means[0] - ours.mean[k]), 0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances[0], ours.covariance[k], rtol=1e-7, atol=1e-10)


# --- Statistics --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(
        product(("planar5", "planar8"), ("ukf", "ekf")),
        lambda model, kind: (model, kind) == ("planar8", "ekf"),
    ),
)
def test_errors_of_the_smoother_agree_with_its_covariance(model: str, kind: str):
    """Use data drawn from the model, see `test_consistency`; check early, in the middle, and at the end."""
    p, line, n = model_parameters(model, kind), time_line(), MODELS[model]
    n = len(n.states)
    runs = runs_needed(n)
    states, fixes = draw(p, runs, seed=0)
    truth, moments = states[line.sampled], [2, 60, -1]
    nees, shrunk = [], []
    for j in range(runs):
        own = replace(line, fixes=np.hstack([fixes[:, j], np.zeros((len(fixes), 4))]))
        piece = next(iter(SmootherRun(FilterPass(own, start(n), Targets.none(own)), p)))
        error = piece.mean[moments] - truth[moments, j]
        error[:, 4] = wrap_angle(error[:, 4])
        covariance = piece.covariance[moments]
        nees.append([e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)])
        shrunk.append(piece.covariance[60, 0, 0])
    low, high = band(runs * n)
    found = np.mean(nees, axis=0) / n
    assert np.all((low < found) & (found < high)), found


# --- Properties --------------------------------------------------------------------------------------------


def test_the_last_estimate_is_the_filters_and_no_covariance_is_larger():
    drive, p = equipped(), parameters("planar8", **OPTIONS["all"])
    filtered, smoothed = run_filter(drive, p), smooth(drive, p)
    np.testing.assert_array_equal(smoothed.time, filtered.time)
    np.testing.assert_allclose(smoothed.mean[-1], filtered.mean[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(smoothed.covariance[-1], filtered.covariance[-1], rtol=1e-9)
    less = np.linalg.eigvalsh(filtered.covariance - smoothed.covariance)
    assert np.all(less[:, 0] > -1e-9)
    assert np.all(np.linalg.eigvalsh(smoothed.covariance)[:, 0] > 0)
    assert smoothed.initial.mean.shape == (8,)
    assert np.all(np.diag(smoothed.initial.covariance)[:5] <= np.diag(began().covariance))


@pytest.mark.parametrize(
    ("model", "kind", "make"),
    [
        ("planar8", "ukf", rough),
        ("planar8", "adaptive-ukf", two_receivers),
        ("planar5", "strong-tracking-ukf", straying),
        ("tilted12", "ekf", rough),
    ],
)
def test_no_bit_depends_on_the_number_of_checkpoints(model: str, kind: str, make):
    p = parameters(model, kind=kind, **OPTIONS["all"])
    drive_pass = whole_pass(make(), began())
    whole = next(iter(SmootherRun(drive_pass, p, samples=100_000)))
    for samples in (1, 7, 300, len(whole.time) - 1):
        pieces = list(SmootherRun(drive_pass, p, samples=samples if samples > 1 else 50))
        for name in ("time", "mean", "covariance", "sound"):
            joined = np.concatenate([getattr(piece, name) for piece in pieces])
            assert joined.tobytes() == getattr(whole, name).tobytes(), (samples, name)


def astray() -> tuple[Drive, InitialState]:
    """Return a wrong initial heading (by 100 degrees) with a small variance: the filter diverges and is reset."""
    drive = equipped(60.0)
    right = initial_state(drive)
    mean = right.mean + np.array([0, 0, 0, 0, np.radians(100)])
    return drive, InitialState(mean, right.covariance, right.time)


SURE = parameters("planar8", gate=9.0)


def test_it_ends_at_a_reset_and_starts_again_after_it():
    drive, wrong = astray()
    whole = smooth(drive, SURE, initial=wrong)
    assert whole.restarts == run_filter(drive, SURE, initial=wrong).restarts != ()
    at = whole.restarts[0]
    assert at % CHECK_INTERVAL < 1.0
    before = whole.time < at
    p = replace(SURE, nominal_interval=drive.nominal_interval)
    cut = smooth(clip(drive, end=at + 1e-6), p, initial=wrong)
    same = smooth(drive, p, initial=wrong)
    np.testing.assert_allclose(same.mean[before], cut.mean[cut.time < at], rtol=0, atol=1e-12)
    # After the reset, nothing depends on earlier estimates or on the length of pieces.
    pieces = [np.concatenate([q.mean for q in SmootherRun(whole_pass(drive, wrong), SURE, samples=n, recover=True)])
              for n in (77, 5000)]  # fmt: skip
    np.testing.assert_array_equal(*pieces)
    filtered = run_filter(drive, SURE, initial=wrong)
    assert np.all(np.abs(whole.mean[before][-1] - filtered.mean[before][-1])[:2] < 50)
    assert np.all(whole.covariance[~before][0].diagonal() < filtered.covariance[~before][0].diagonal())


def test_estimates_before_a_failure_are_smoothed():
    drive, p = equipped(), parameters("planar5")
    ax = drive.imu.ax.copy()
    ax[1500] = np.nan
    ill = replace(drive, imu=replace(drive.imu, ax=ax))
    found = smooth(ill, p, initial=began())
    sound = np.isfinite(found.mean).all(axis=1)
    assert found.failure is not None
    assert "failed at t" in found.failure
    assert np.array_equal(sound, found.time < drive.imu.time[1500])
    cut = smooth(
        clip(drive, end=float(drive.imu.time[1500])), replace(p, nominal_interval=0.01), initial=began()
    )
    whole = smooth(ill, replace(p, nominal_interval=0.01), initial=began())
    np.testing.assert_allclose(whole.mean[sound], cut.mean, rtol=0, atol=1e-9)
    with pytest.raises(SigmaswarmError, match="failed at t"):
        list(estimates_of(SmootherRun(whole_pass(ill, began()), p, recover=True)))


def test_truth_is_not_read():
    drive, p = equipped(), parameters("planar8")
    blind = smooth(replace(drive, truth=None), p)
    assert blind.mean.tobytes() == smooth(drive, p).mean.tobytes()


def test_the_pieces_equal_the_whole():
    drive, p = equipped(), parameters("planar8")
    whole = smooth(drive, p)
    parts = list(estimates_of(SmootherRun(whole_pass(drive), p, recover=True)))
    assert np.concatenate([part.mean for part in parts]).tobytes() == whole.mean.tobytes()
    assert not np.any(whole.lost)


# --- A fixed lag -------------------------------------------------------------------------------------------


def live(drive: Drive, p: FilterParameters, lag: float, *, late: float = 0.0, asked: set[int]):
    """Return a live filter and its smoothed states after these samples; fixes arrive ``late`` s late."""
    initial, imu, gps = initial_state(drive), drive.imu, drive.gps
    lever = [*drive.lever_arm, drive.antenna_height]
    filter = LiveFilter(p, initial, nominal_interval=drive.nominal_interval, lever_arm=lever, lag=lag)
    axes = [getattr(imu, axis) for axis in MODELS[p.model].imu]
    events = [(t, 1, i) for i, t in enumerate(imu.time)] + [(t + late, 0, i) for i, t in enumerate(gps.time)]
    said = {}
    for t, is_imu, i in sorted(events):
        if is_imu:
            filter.predict(t, [axis[i] for axis in axes])
            if i in asked:
                said[i] = filter.smoothed
        else:
            velocity = None
            if gps.speed is not None and gps.course is not None:
                velocity = gps.speed[i] * np.array([np.cos(gps.course[i]), np.sin(gps.course[i])])
            filter.update(gps.time[i], (gps.x[i], gps.y[i]), velocity)
    return filter, said


@pytest.mark.parametrize(
    ("model", "kind", "late"),
    quickly(
        [
            ("planar5", "strong-tracking-ukf", 0.0),
            ("planar8", "ukf", 0.07),
            ("tilted12", "ekf", 0.0),
            ("tilted12", "ukf", 0.0),
        ],
        lambda model, kind, late: (model, kind) != ("tilted12", "ukf"),
    ),
)
def test_the_live_smoother_equals_the_batch_smoother_at_the_lag(model: str, kind: str, late: float):
    drive = equipped() if model == "tilted12" else rough()
    p = parameters(model, kind=kind, **OPTIONS["all"], nominal_interval=drive.nominal_interval)
    first = int(np.searchsorted(drive.imu.time, began().time, side="right"))
    asked = {first, first + 40, 1100, 1500, 2011}
    filter, said = live(drive, p, 2.0, late=late, asked=asked)
    for i in asked:
        now = drive.imu.time[i]
        # Fixes that have not yet arrived are removed.
        gps = drive.gps.select(drive.gps.time <= now - late)
        batch = smooth(clip(replace(drive, gps=gps), end=now + 1e-9), p, initial=began(), recover=False)
        before = np.flatnonzero(batch.time <= now - 2.0 + 1e-6)
        if len(before):
            time, mean, covariance = (x[before[-1]] for x in (batch.time, batch.mean, batch.covariance))
        else:  # the lag is before the start
            of = batch.initial
            time, mean, covariance = of.time, of.mean, of.covariance
        assert said[i].time == time
        assert not said[i].failed
        np.testing.assert_allclose(said[i].mean, mean, rtol=0, atol=1e-9, err_msg=str(i))
        np.testing.assert_allclose(said[i].covariance, covariance, rtol=0, atol=1e-9)
    assert filter.state.time == drive.imu.time[-1]


def test_a_live_filter_does_not_smooth_across_a_reset():
    drive, wrong = astray()
    restart = run_filter(drive, SURE, initial=wrong).restarts[0]
    filter = LiveFilter(SURE, wrong, nominal_interval=drive.nominal_interval, lever_arm=[1.0, 0.5], lag=2.0)
    fixes = iter(zip(drive.gps.time, drive.gps.x, drive.gps.y, strict=True))
    fix, times = next(fixes), []
    for t, ax, ay, gz in zip(
        *(getattr(drive.imu, c)[:4000] for c in ("time", "ax", "ay", "gz")), strict=True
    ):
        while fix[0] <= t:
            filter.update(fix[0], fix[1:])
            fix = next(fixes)
        filter.predict(t, (ax, ay, gz))
        if abs(t - restart) < 3.0:
            times.append((t, filter.smoothed.time))
    now, of = np.array(times).T
    assert filter.restarts[0] == pytest.approx(restart, abs=1.1)
    restart = filter.restarts[0]
    assert np.all(of[(now >= restart) & (now <= restart + 2.0)] == restart)
    assert np.all(of[now < restart] < restart - 1.9)
    assert np.all(np.diff(of) >= 0)


@pytest.mark.parametrize("lag", [0.0, -1.0, np.inf, np.nan])
def test_an_invalid_lag_is_rejected(lag: float):
    with pytest.raises(InputError, match="positive number of seconds"):
        LiveFilter(parameters("planar5"), began(), nominal_interval=0.01, lag=lag)


def test_without_a_lag_there_is_no_smoothed_state():
    with pytest.raises(InputError, match=r"lag=2\.0"):
        _ = LiveFilter(parameters("planar5"), began(), nominal_interval=0.01).smoothed
