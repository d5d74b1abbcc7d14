"""The filter bank: each lane is a filter, its estimate is their mixture, and equal samples give equal bits."""

import math
import pickle
import signal
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import processes
from filter_cases import OPTIONS, WEIGHED, equipped, parameters
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gyro_bias import GyroBiasEvidence
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.bank.mixture import Mixture
from sigmaswarm.filters.bank.offsets import FIXED_OFFSETS, START, OffsetPrior, R
from sigmaswarm.filters.bank.run import BankRun, run_bank
from sigmaswarm.filters.bank.search import FilterEvidence, LoggedSteps, search
from sigmaswarm.filters.compiled import layout, swarm
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import GYRO_BIAS, MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter, run_innovations, whole_pass
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.scenarios import simulate
from support import make_drive, quickly

ALL = OPTIONS["all"]


@cache
def drive() -> Drive:
    return equipped(45.0)


@cache
def start() -> InitialState:
    return initial_state(drive())


def made(cls, p: FilterParameters, **more):
    return cls(p, start(), nominal_interval=drive().nominal_interval, lever_arm=[1.0, 0.5, 1.2], **more)


def events(late: float = 0.0) -> list[tuple[float, bool, int]]:
    """Return IMU samples and fixes in the order of arrival; fixes arrive ``late`` s after their time."""
    samples = [(t, True, i) for i, t in enumerate(drive().imu.time)]
    return sorted(samples + [(t + late, False, i) for i, t in enumerate(drive().gps.time)])


def feed(filter: LiveFilter, stream: list[tuple[float, bool, int]]) -> Iterator[float]:
    """Feed a filter with a stream; yield the time after each IMU sample."""
    imu, gps = drive().imu, drive().gps
    axes = MODELS[filter.parameters.model].imu
    for t, is_imu, i in stream:
        if is_imu:
            filter.predict(t, [getattr(imu, axis)[i] for axis in axes])
            yield t
        else:
            velocity = (gps.speed[i] * math.cos(gps.course[i]), gps.speed[i] * math.sin(gps.course[i]))
            filter.update(gps.time[i], (gps.x[i], gps.y[i]), velocity, (0.5, 0.6))


def fed(cls, p: FilterParameters, late: float = 0.0, **more):
    filter = made(cls, p, **more)
    for _ in feed(filter, events(late)):
        pass
    return filter


@cache
def whole() -> LiveFilterBank:
    """Return a bank after the whole drive."""
    return fed(LiveFilterBank, parameters("planar8", **ALL))


def everything(of: LiveFilterBank) -> bytes:
    """Return all numbers of the lanes, their offsets and the population of the search as bytes."""
    return of._numbers[: swarm.N_CHECKPOINT].tobytes() + of.offsets.tobytes() + of._population.tobytes()


def test_fixes_older_than_the_history_are_left_out_and_counted():
    assert fed(LiveFilterBank, parameters("planar5"), late=0.5, history=0.2).too_late > 50


@pytest.mark.parametrize(
    ("model", "option", "late"),
    quickly(
        [
            (model, option, late)
            for model, option in (
                ("planar8", ALL),
                ("planar8", WEIGHED["both"]),
                ("planar5", OPTIONS["velocity"]),
                ("tilted12", ALL),
                ("tilted12", {**ALL, "kind": "ukf"}),
            )
            for late in (0.0, 0.23)
        ],
        lambda model, option, late: late > 0 and option == WEIGHED["both"],
    ),
)
def test_lane_0_equals_the_live_filter_of_the_tuning(model: str, option: dict[str, float], late: float):
    if model == "tilted12" and drive().imu.az is None:
        pytest.skip("the drive has three axes")
    p = parameters(model, **option)
    alone, among = made(LiveFilter, p), made(LiveFilterBank, p)
    for _, _ in zip(feed(alone, events(late)), feed(among, events(late)), strict=True):
        ours, theirs = among._estimate(), alone._estimate()
        assert [each.tobytes() for each in ours[:2]] == [each.tobytes() for each in theirs[:2]]
    assert among.n_searches >= 2
    assert among.too_late == alone.too_late == 0


@pytest.mark.parametrize("option", quickly([("all",), ("both",)], lambda option: option == "both"))
def test_late_fixes_change_no_bit_of_the_settled_parameters(option: str):
    p = parameters("planar8", **{**OPTIONS, **WEIGHED}[option])
    in_time, late = fed(LiveFilterBank, p), fed(LiveFilterBank, p, 0.31)
    for filter in (in_time, late):
        for _ in feed(filter, [e for e in events() if not e[1] and e[0] > drive().imu.time[-1] - 0.5]):
            pass
    assert in_time.n_searches == late.n_searches >= 2
    assert everything(late) == everything(in_time)
    assert everything(fed(LiveFilterBank, p, seed=1)) != everything(in_time)


def test_reading_the_state_changes_no_bit():
    """The result depends neither on when the state is read nor on when a search ends."""
    p = parameters("planar8", **ALL)
    asked = made(LiveFilterBank, p)
    for k, _ in enumerate(feed(asked, events())):
        if k % 7 == 0:
            _ = asked.state, asked.weights, asked.settled, asked.innovation
        if k % 100 == 0 and asked._pending is not None:
            asked._pending.result()
    assert everything(asked) == everything(whole())


def test_a_replaced_lane_uses_its_new_heading():
    among = made(LiveFilterBank, parameters("planar5"))
    steps = [(start().time + 0.01 * k, (1.0, 0.0, 0.0)) for k in range(1, 5)]
    for t, seen in steps[:3]:
        among.predict(t, seen)
    rows = among._rows_of(among._numbers)
    rows[[layout.R.T, layout.R.SIN_COS_VALID], 7] = 2.5, 0.0
    before = rows[[layout.R.U, layout.R.V], 7]
    among.predict(*steps[3])
    east, north = rows[[layout.R.U, layout.R.V], 7] - before
    assert abs(math.atan2(north, east) - 2.5) < 1e-9


@pytest.mark.parametrize("option", quickly([("all",), ("both",)], lambda option: option == "both"))
def test_lanes_are_filters_and_the_estimate_is_their_mixture(option: str):
    """Without a search: compare with one run per lane, and with a mixture in plain NumPy."""
    p = parameters("planar8", **{**OPTIONS, **WEIGHED}[option])
    seen = replace(
        drive(),
        gps=replace(drive().gps, std_x=np.full(len(drive().gps), 0.5), std_y=np.full(len(drive().gps), 0.6)),
    )
    found = fed(LiveFilterBank, p, searches=False)
    nothing = np.zeros(len(found.prior.names))
    with pytest.warns(SigmaswarmWarning, match="is deprecated, use LiveFilterBank.prior"):
        assert found.spread is found.prior
    with pytest.warns(SigmaswarmWarning, match="is deprecated, use LiveFilterBank.bank_restarts"):
        assert found.swarm_restarts == found.bank_restarts
    with pytest.warns(SigmaswarmWarning, match="is deprecated, use OffsetPrior.warnings"):
        assert found.prior.said(nothing) == found.prior.warnings(nothing)
    states, weights = found.lanes()
    evidence, means, covariances = np.zeros(LANES), [], []
    for lane in range(LANES):
        own = found.prior.parameters(found.offsets[lane])
        run = run_filter(seen, own, initial=start())
        means.append(run.mean[-1])
        covariances.append(run.covariance[-1])
        innovations = run_innovations(seen, own, initial=start())
        before = start().time
        for t, nis, s in zip(innovations.time, innovations.nis, innovations.covariance, strict=True):
            loss = 0.5 * math.log(np.linalg.det(s)) + 0.5 * min(nis, swarm.LARGEST_NIS)
            evidence[lane] = evidence[lane] * math.exp((before - t) / swarm.EVIDENCE_LASTS) - loss
            before = t
    np.testing.assert_allclose(found._numbers[swarm.EVIDENCE], evidence, rtol=1e-8)
    log = swarm.EVIDENCE_COUNTS * evidence - found.prior.penalty(found.offsets)
    expected = np.exp(log - log.max()) / np.exp(log - log.max()).sum()
    np.testing.assert_allclose(weights, expected, rtol=1e-6)
    means, covariances = np.array(means), np.array(covariances)
    means[:, 4] = means[0, 4] + wrap_angle(means[:, 4] - means[0, 4])
    mean = expected @ means
    prior = sum(w * np.outer(m - mean, m - mean) for w, m in zip(expected, means, strict=True))
    mixed = found.state
    np.testing.assert_allclose(mixed.mean, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        mixed.covariance, np.einsum("l,lij->ij", expected, covariances) + prior, rtol=1e-6
    )
    assert states.shape[1] == LANES


def test_the_mean_heading_of_a_mixture_is_a_circular_mean():
    p = parameters("planar5")
    states = np.zeros((1, 20, LANES))
    states[0, 4] = np.where(np.arange(LANES) % 2, math.pi - 0.1, -math.pi + 0.1)
    mixed = Mixture.of(states, np.full((1, LANES), 1 / LANES), p.model)
    assert abs(wrap_angle(mixed.mean[0, 4] - math.pi)) < 1e-12
    assert mixed.covariance[0, 4, 4] == pytest.approx(0.01)
    states[0, :, 3] = np.nan  # a failed lane has no weight
    weights = np.full((1, LANES), 1 / (LANES - 1))
    weights[0, 3] = 0.0
    assert np.isfinite(Mixture.of(states, weights, p.model).mean).all()
    assert np.isnan(Mixture.of(states, np.zeros((1, LANES)), p.model).mean).all()


@given(hnp.arrays(float, 13, elements=st.floats(-2.0, 2.0)))
def test_the_kernels_constants_are_those_of_the_parameters(offsets: np.ndarray):
    for model, option in (("planar8", WEIGHED["both"]), ("tilted12", ALL), ("planar5", {})):
        prior = OffsetPrior(parameters(model, **option))
        own = KernelArray((prior.tuning,)).constants(0.01)[:, :1]
        by = np.resize(offsets, len(prior.names))
        packed = KernelArray((prior.parameters(by),)).constants(0.01)[:, 0]
        np.testing.assert_allclose(prior.constants(own, by[np.newaxis])[:, 0], packed, rtol=1e-12)
    assert prior.constants(own, np.zeros((1, len(prior.names))))[:, 0].tobytes() == own[:, 0].tobytes()


def resumed(saved: bytes, stream: list[tuple[float, bool, int]]) -> bytes:
    filter = pickle.loads(saved)
    for _ in feed(filter, stream):
        pass
    return everything(filter) + filter.state.mean.tobytes()


def test_a_pickled_bank_and_the_original_continue_with_the_same_bits():
    filter, stream = made(LiveFilterBank, parameters("planar8", **ALL)), events()
    cut = next(k for k, e in enumerate(stream) if e[0] > start().time + 20.5)  # a search is running
    for _ in feed(filter, stream[:cut]):
        pass
    assert filter._pending is not None
    saved = pickle.dumps(filter)
    assert resumed(saved, stream[cut:]) == everything(whole()) + whole().state.mean.tobytes()
    for _ in feed(filter, stream[cut:]):
        pass
    assert everything(filter) == everything(whole())


DIES = """
import os, pickle, signal, sys
from pathlib import Path
from filters.test_bank import ALL, LiveFilterBank, events, feed, made, parameters, start

filter = made(LiveFilterBank, parameters("planar8", **ALL))
kept = 0.0
for t in feed(filter, events()):
    if t > kept + 0.31:  # as a car would: every now and then, whole or not at all
        kept = t
        Path("next").write_bytes(pickle.dumps((t, filter)))
        os.replace("next", "saved")
    if t > start().time + 20.7:  # a search is under way, and samples have come since
        os.kill(os.getpid(), signal.SIGKILL)
"""
GOES_ON = """
import pickle, sys
from pathlib import Path
from filters.test_bank import events, everything, feed

t, filter = pickle.loads(Path("saved").read_bytes())
stream = events()
for _ in feed(filter, stream[1 + stream.index((t, True, next(i for at, s, i in stream if s and at == t))):]):
    pass
Path("end").write_bytes(everything(filter) + filter.state.mean.tobytes())
"""


def test_a_killed_process_resumes_from_its_last_save_with_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert processes.run(DIES).returncode == -signal.SIGKILL
    t, saved = pickle.loads(Path("saved").read_bytes())
    assert start().time + 20.0 < t < start().time + 20.7
    assert saved._pending is not None
    gone_on = processes.run(GOES_ON)
    assert gone_on.returncode == 0, gone_on.stderr
    assert whole().n_searches >= 2
    assert Path("end").read_bytes() == everything(whole()) + whole().state.mean.tobytes()


def test_a_search_finds_better_offsets_and_is_reproducible():
    p = parameters("planar8", **ALL)
    filter = fed(LiveFilterBank, p, searches=False)
    logged = filter._logged_steps(0, int(filter._numbers[swarm.LOGGED]))
    begins, told = filter._snapshots[0].lanes[:, 0], FilterEvidence(0.0, start().time)
    steps = LoggedSteps(p.model, logged, np.array([1.0, 0.5, 1.2]))
    zero = np.zeros(len(filter.prior.names))
    wrong = zero.copy()
    wrong[filter.prior.names.index(R)] = 2.0
    population = filter.prior.first(np.random.default_rng(1))

    def evidence_of(offsets: np.ndarray) -> float:
        """Return the evidence of lane 8 in a bank that starts with these offsets."""
        own = made(LiveFilterBank, p, searches=False)
        own.offsets[8] = offsets
        own._start_lanes(start(), slice(None))
        for _ in feed(own, events()):
            pass
        return float(own._numbers[swarm.EVIDENCE][8])

    def found():
        return search(filter.prior, steps, begins, told, wrong, population, drive().nominal_interval, (3,))

    first, again = found(), found()
    assert first is not None and again is not None
    assert first.known.evidence > evidence_of(wrong) + 10.0  # ``wrong`` multiplies R by 100
    assert abs(first.offsets[filter.prior.names.index(R)]) < 1.0
    assert first.offsets.tobytes() == again.offsets.tobytes()
    assert first.lane.tobytes() == again.lane.tobytes()
    assert first.known == again.known
    assert first.known.evidence == pytest.approx(evidence_of(first.offsets), rel=1e-9)
    few = LoggedSteps(p.model, logged[:300], np.zeros(3))
    assert search(filter.prior, few, begins, told, zero, population, 0.01, (0,)) is None


@pytest.mark.parametrize(
    "kind", quickly([("ukf",), ("adaptive-ukf",), ("fuzzy-ukf",)], lambda kind: kind == "adaptive-ukf")
)
def test_the_fixed_lanes_stay(kind: str):
    p = parameters("planar8", kind=kind, **ALL)
    first, last = made(LiveFilterBank, p), fed(LiveFilterBank, p)
    assert last.n_searches >= 2
    states = Mixture.of(last.lanes()[0][np.newaxis].repeat(LANES, 0), np.eye(LANES), p.model)
    for lane in range(len(FIXED_OFFSETS)):  # searches do not change these lanes
        alone = run_filter(drive(), last.prior.parameters(last.offsets[lane]), initial=start())
        np.testing.assert_allclose(wrap_angle(states.mean[lane] - alone.mean[-1]), 0.0, atol=1e-9)
        np.testing.assert_allclose(states.covariance[lane], alone.covariance[-1], rtol=1e-7, atol=1e-13)
    np.testing.assert_array_equal(first.offsets[: len(FIXED_OFFSETS)], last.offsets[: len(FIXED_OFFSETS)])
    assert not np.array_equal(first.offsets[len(FIXED_OFFSETS) :], last.offsets[len(FIXED_OFFSETS) :])
    assert np.isfinite(last.offsets).all()
    assert (last.offsets[len(FIXED_OFFSETS) :, last.prior.names.index(START)] == 0.0).any()


def test_a_different_receiver_is_reported():
    """A filter that was tuned for errors of 0.5 m is used with a receiver with errors of 4 m."""
    seen = make_drive(duration=90.0, gps_std=4.0, seed=3)
    p = parameters("planar8", lateral_noise=0.01, rear_axle=0.0)
    run = BankRun(whole_pass(seen), p, recover=True)
    error = {"swarm": np.concatenate([piece.mean[:, :2] for piece in run])}
    error["tuning"] = run_filter(seen, p).mean[:, :2]
    t = seen.imu.time[seen.imu.time > run.initial.time]
    true = np.column_stack([np.interp(t, seen.truth.time, c) for c in (seen.truth.x, seen.truth.y)])
    rmse = {name: float(np.sqrt(np.square(of - true).sum(axis=1).mean())) for name, of in error.items()}
    assert rmse["swarm"] < 0.75 * rmse["tuning"]
    r = run.log.settled[run.bank.prior.names.index(R)] + run.log.settled[run.bank.prior.names.index("scale")]
    assert 0.8 < r < 2.6  # log10(4^2 / 0.5^2) = 1.8; log10(4^2 / 0.6^2) = 1.65
    assert any("a different receiver" in sentence for sentence in run.bank.prior.warnings(run.log.settled))
    nis = {"swarm": run.innovations.nis.mean(), "tuning": run_innovations(seen, p).nis.mean()}
    assert abs(math.log(nis["swarm"] / 2)) < 0.5 * abs(math.log(nis["tuning"] / 2))


def test_run_bank_equals_the_live_bank():
    p = parameters("planar8", lateral_noise=0.05)
    run = run_bank(prepare_drive(drive(), start()), p)
    filter = made(LiveFilterBank, p)
    means = [filter.state.mean for t in feed(filter, events()) if t > start().time]
    np.testing.assert_allclose(
        np.unwrap(run.mean, axis=0), np.unwrap(np.array(means), axis=0), rtol=0, atol=1e-9
    )
    assert run.failure is None
    assert run.covariance.shape == (len(means), 8, 8)


@pytest.mark.parametrize(  # before, during and after a search
    "at", quickly([(11.9,), (13.2,), (13.9,), (15.1,), (15.9,), (17.0,)], lambda at: at == 13.2)
)
def test_a_failure_of_all_lanes_is_reported_at_once_and_the_bank_is_reset(at: float):
    p = parameters("planar8", **ALL)
    filter, failed = made(LiveFilterBank, p), []
    for t in feed(filter, events()):
        if not failed and t > at:
            filter.predict(t + 1e-4, (math.nan, 0.0, 0.0))
            assert filter.state.failed
        if t > at:
            failed.append(filter.state.failed)
    assert not failed[-1]  # the bank was aligned with fixes
    true = np.array([drive().truth.x[-1], drive().truth.y[-1]])
    assert np.linalg.norm(filter.state.mean[:2] - true) < 5.0
    assert filter.state.covariance[0, 0] < 4.0


BIAS = 0.25


@cache
def biased() -> Drive:
    """Return a drive with a gyro bias of BIAS rad/s, as in an uncalibrated gyro."""
    made = simulate("urban", seed=4, duration=60.0, gps="white-1m")
    return replace(made, imu=replace(made.imu, gz=made.imu.gz + BIAS))


def biases(turned_at: float = math.inf, held_at: float = math.inf) -> tuple[LiveFilterBank, np.ndarray]:
    """Run a bank on that drive; return it, and times with the median gyro bias of its lanes.

    At one time, all headings are turned, or both monitors are set to diverged.
    """
    p = parameters("planar8", lateral_noise=0.05, rear_axle=1.5, bias_std=(0.5, 0.3))
    imu, gps = biased().imu, biased().gps
    filter = LiveFilterBank(p, initial_state(biased()), nominal_interval=0.01, searches=False)
    fixes, found = iter(zip(gps.time, gps.x, gps.y, strict=True)), []
    fix = next(fixes, None)
    for t, *sample in zip(imu.time, imu.ax, imu.ay, imu.gz, strict=True):
        while fix and fix[0] <= t:
            filter.update(fix[0], fix[1:])
            fix = next(fixes, None)
        filter.predict(t, sample)
        if t >= turned_at:
            filter._rows_of(filter._numbers)[THETA] += 2.5
            turned_at = math.inf
        if t >= held_at:
            assert filter._monitor and filter._together
            filter._monitor.lost = filter._together.lost = filter._holds = True
            held_at = math.inf
        found.append((t, np.median(filter.lanes()[0][GYRO_BIAS, len(FIXED_OFFSETS) :])))
    return filter, np.array(found)


@pytest.mark.long
def test_a_gyro_bias_that_the_bank_estimates_causes_no_reset():
    filter, found = biases()
    assert not filter.restarts  # nor is the live filter, whose alignment estimates the bias
    assert not filter.bank_restarts
    assert abs(found[-1, 1] - BIAS) < 0.02


@pytest.mark.long
def test_estimated_biases_are_kept_at_a_reset():
    filter, found = biases(turned_at=30.0)
    began = filter.bank_restarts[0]
    after = found[(found[:, 0] >= began) & (found[:, 0] < began + 0.5), 1]
    assert abs(after - BIAS).max() < 0.05


def test_estimated_biases_are_kept_while_the_bank_is_lost():
    filter, found = biases(held_at=30.005)
    began = filter.bank_restarts[0]
    assert 0.05 < began - 30.0 < 3.0
    after = found[(found[:, 0] >= began) & (found[:, 0] < began + 0.5), 1]
    assert abs(after - BIAS).max() < 0.05


def test_while_it_is_lost_the_biases_are_the_last_valid_ones():
    filter = made(LiveFilterBank, parameters("planar8"))
    sound, variance = np.arange(8.0), np.diag(np.arange(1.0, 9.0)) + 0.1
    known = filter._with_sound_biases(False, sound.copy(), variance.copy())
    assert [each.tobytes() for each in known] == [sound.tobytes(), variance.tobytes()]
    mean, covariance = filter._with_sound_biases(True, sound + 1.0, 4.0 * variance)
    np.testing.assert_array_equal(mean, [*(sound[:5] + 1.0), *sound[5:]])
    np.testing.assert_array_equal(covariance[:5, :5], 4.0 * variance[:5, :5])
    np.testing.assert_array_equal(covariance[5:, 5:], variance[5:, 5:])
    assert not covariance[:5, 5:].any() and not covariance[5:, :5].any()


@pytest.mark.parametrize(
    ("taken", "variance", "kept"),
    [(None, 1.0, True), (0.2, 1.0, True), (0.2, 1e-6, False), (0.3, 1.0, False)],
)
def test_a_reset_takes_the_bias_of_an_alignment_that_is_more_certain_or_contradicts(
    taken: float | None, variance: float, kept: bool
):
    filter = made(LiveFilterBank, parameters("planar8"))
    gyro = None if taken is None else GyroBiasEvidence(np.zeros(3), np.full(3, variance), taken, np.zeros(5))
    rows, before = filter._rows_of(filter._numbers), filter.lanes()[0].copy()
    mean, covariance = np.full(8, 0.2), np.diag(np.full(8, 0.01))
    new = InitialState(np.full(5, 7.0), np.eye(5), start().time, gyro)
    filter._keep_biases(new, 0.2, mean, covariance)
    with_others = [0, *(lane for lane, by in enumerate(FIXED_OFFSETS) if START in by)]
    changed = [lane for lane in range(LANES) if kept and lane not in with_others]
    other = np.setdiff1d(np.arange(LANES), changed)
    np.testing.assert_array_equal(filter.lanes()[0][:, other], before[:, other])
    np.testing.assert_array_equal(rows[layout.state_rows("planar8")[:5]][:, changed], 7.0)
    np.testing.assert_array_equal(filter.lanes()[0][5:8, changed], 0.2)
    for i in (5, 6, 7):
        np.testing.assert_array_equal(rows[layout.at(i, i)][changed], 0.01)


def test_a_fix_with_an_overflowing_position_causes_no_failure():
    p = parameters("planar8", gate=6.0)
    alone, among = made(LiveFilter, p), made(LiveFilterBank, p)
    for filter in (alone, among):
        for k, t in enumerate(feed(filter, events())):
            if k == 1500:
                filter.update(t, (1e160, 0.0))
    assert not alone.state.failed
    assert not among.state.failed
    assert among.n_searches >= 2


def test_a_deep_copy_is_independent():
    filter, stream = made(LiveFilterBank, parameters("planar8", **ALL)), events()
    for _ in feed(filter, stream[:2000]):
        pass
    copy = deepcopy(filter)
    for _ in feed(copy, stream[2000:]):
        pass
    for _ in feed(filter, stream[2000:]):
        pass
    assert everything(copy) == everything(filter) == everything(whole())


@pytest.mark.long
def test_a_forked_child_continues_with_the_same_bits():
    p, stream = parameters("planar8", **ALL), events()
    filter = made(LiveFilterBank, p)
    cut = next(k for k, e in enumerate(stream) if e[0] > start().time + 20.5)  # a search is running
    for _ in feed(filter, stream[:cut]):
        pass
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        child = pool.submit(resumed, pickle.dumps(filter), stream[cut:]).result(timeout=120)
    assert child == everything(whole()) + whole().state.mean.tobytes()


def test_after_a_long_gap_of_the_imu_the_estimate_is_not_stale():
    imu = drive().imu
    heard = (imu.time < 20.0) | (imu.time > 32.5)
    silent = replace(drive(), imu=imu.select(heard))
    p = parameters("planar8", lateral_noise=0.05)
    run, of_one = run_bank(prepare_drive(silent, start()), p), run_filter(silent, p, initial=start())
    apart = np.hypot(*(run.mean[:, :2] - of_one.mean[:, :2]).T)
    assert apart.max() < 5.0


def test_the_settled_parameters_keep_the_initial_bias_deviation():
    assert whole().settled.bias_std == whole().parameters.bias_std
    assert whole().settled.process_noise != whole().parameters.process_noise


def test_a_common_factor_of_all_variances_is_reported_once():
    prior = OffsetPrior(parameters("planar8", **ALL))
    by = dict.fromkeys(prior.names, 0.0)

    def said(**of: float) -> tuple[str, ...]:
        return prior.warnings(np.array([*(by | of).values()]))

    assert said() == ()
    (common,) = said(scale=1.0)
    assert common.startswith("the common factor of all variances is 10 times")
    (receiver,) = said(r=0.4, scale=0.4)
    assert receiver == "R is 6.3 times the tuned value, which indicates a different receiver"
    assert [s for s in said(r=1.0, scale=-1.0) if s.startswith("R is")] == []
    (axle,) = said(rear_axle=1.2)
    assert axle == "the rear axle is 1.2 m farther back than in the tuning"


def test_a_failed_lane_has_no_weight_and_restarts_from_the_best_lane():
    p, filter = parameters("planar8", **ALL), None
    filter = made(LiveFilterBank, p)
    for k, _ in enumerate(feed(filter, events())):
        if k == 1000:
            filter._rows_of(filter._numbers)[:, [2, 9]] = np.nan
            assert not filter.state.failed  # before the next fix
        if k == 1100:  # after several fixes
            assert (filter.weights[[2, 9]] == 0.0).all()
            assert not filter.state.failed
    assert (filter.weights[[2, 9]] > 0.0).all()  # after the next search


@pytest.mark.long
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="takes minutes uncompiled")
def test_memory_stays_flat():
    filter = LiveFilterBank(parameters("planar8", **ALL), start(), nominal_interval=0.01)
    t0 = start().time

    def run(first: int, last: int) -> None:
        for k in range(first, last):
            t = t0 + 0.01 * (k + 1)
            if k % 20 == 10:
                filter.update(t - (0.2 if k % 100 == 10 else 0.004), (0.05 * k, 0.01 * (k % 7)), (5.0, 0.0))
            filter.predict(t, (0.01 * math.sin(k), 0.0, 0.0))

    run(0, 12_000)
    tracemalloc.start()
    run(12_000, 14_000)
    before = tracemalloc.get_traced_memory()[0]
    run(14_000, 20_000)
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert growth < 2_000_000  # steps are stored while a search is running
    assert not filter.state.failed
