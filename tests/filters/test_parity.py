"""The compiled filter, the textbook filter, FilterPy, and an extended-precision oracle, held together.

Far from its optimum a Kalman filter is chaotic, so whole runs can't be compared to 1e-9. One step can: both
sides restart from the same state at every step of a drive. The functions that measure are also what
benchmarks/parity.py prints whole figures with; the tests run them on slices.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise, product

import numba
import numpy as np
import pytest

from oracles.extended_ukf import LOWER, UPPER, ExtendedUkf, box_table, covariance_error, mean_error
from oracles.filterpy_ukf import FilterPyUkf
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.timeline import Timeline, build_timeline
from sigmaswarm.filters.batch import (
    Replay,
    Targets,
    pack_constants,
    pack_states,
    record_replay,
    run_replay,
    unpack_states,
)
from sigmaswarm.filters.compiled import lanes, run
from sigmaswarm.filters.models import THETA, gps_position, planar5
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.reference import SigmaPoints, UnscentedKalmanFilter
from support import DRIVES, make_drive, needs_shared

EPS = np.finfo(float).eps
TWIN_TURN = 1e-13  # rad, how far the twin's initial heading is moved
TWIN_LIMIT = 1e-12  # where the twin is farther away, the filter is chaotic and proves nothing


# --- How it is measured ------------------------------------------------------------------------------------


def as_parameters(table: np.ndarray) -> list[FilterParameters]:
    """The library's records of a table's rows."""
    return [FilterParameters(*map(float, row[:3]), tuple(row[3:8]), tuple(row[8:])) for row in table]


def steps_with_fixes(
    timeline: Timeline, n_steps: int | None = None
) -> Iterator[tuple[int, np.ndarray | None]]:
    """Each step's number and the fix absorbed at its end."""
    fixes = iter(timeline.fixes)
    for i in range(len(timeline.dt))[:n_steps]:
        yield i, next(fixes) if timeline.absorbs[i] else None


def compiled_step(
    timeline: Timeline,
    i: int,
    fix: np.ndarray | None,
    mean: np.ndarray,
    covariance: np.ndarray,
    constants: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step ``i`` by the compiled filter, from one state per lane; mean, covariance, sums."""
    t = timeline
    steps = np.array([[t.dt[i], t.ax[i], t.ay[i], t.gz[i], t.q_scale[i]]])
    flags = np.array([run.IMU if fix is None else run.IMU | run.FIX])
    fixes = np.empty((0, 4)) if fix is None else fix[None].copy()
    nothing = np.empty((0, 5)), np.zeros(1, dtype=np.int64)
    record = np.empty((0, lanes.N_STATE + 1, 0))
    start = pack_states(mean, covariance)
    sums, final = run.run_lanes(5, steps, flags, fixes, np.zeros(2), *nothing, start, constants, record)
    return *unpack_states(final, 5), sums


@dataclass(frozen=True, eq=False)
class Stepwise:
    """Errors of single steps, each (steps, sets).

    ``shrunk`` says by how much a step's fix divided a variance, at most; 1 where there was no fix. A covariance
    kept in doubles can't come out of such a fix with more than eps x shrunk: that much is rounded off before.
    ``sums`` has only the steps that absorb a fix.
    """

    mean: np.ndarray
    covariance: np.ndarray
    shrunk: np.ndarray
    sums: np.ndarray | None = None

    def beyond(self, tolerance: float, margin: float) -> np.ndarray:
        """The covariance's error over the larger of ``tolerance`` and what the fix must lose, x ``margin``."""
        return self.covariance / np.maximum(tolerance, margin * EPS * self.shrunk)


def shrinkage(prior: np.ndarray, posterior: np.ndarray) -> np.ndarray:
    """The largest P_ii before over P_ii after, (...)."""
    before, after = (np.diagonal(p, axis1=-2, axis2=-1) for p in (prior, posterior))
    return np.max(before / after, axis=-1).astype(float)


def compiled_against_extended(
    timeline: Timeline, initial: InitialState, table: np.ndarray, n_steps: int | None = None
) -> Stepwise:
    """One step at a time, restarted from the oracle's trajectory, rounded to doubles."""
    padding = -len(table) % lanes.LANES
    padded = np.vstack([table, table[-1:].repeat(padding, axis=0)])
    chunks = [slice(a, b) for a, b in pairwise(range(0, len(padded) + 1, lanes.LANES))]
    constants = [pack_constants(as_parameters(padded[part]), timeline.nominal_interval) for part in chunks]
    oracle = ExtendedUkf(padded)
    oracle.restart(initial.mean, initial.covariance)
    errors: list[tuple[np.ndarray, ...]] = []
    sums: list[np.ndarray] = []
    for i, fix in steps_with_fixes(timeline, n_steps):
        mean, covariance = oracle.mean.astype(np.float64), oracle.covariance.astype(np.float64)
        parts = [
            compiled_step(timeline, i, fix, mean[part], covariance[part], constant)
            for part, constant in zip(chunks, constants, strict=True)
        ]
        new_mean, new_covariance = (np.concatenate([part[j] for part in parts]) for j in (0, 1))
        oracle.restart(mean, covariance)
        oracle.predict(timeline.dt[i], timeline.ax[i], timeline.ay[i], timeline.gz[i], timeline.q_scale[i])
        prior = oracle.covariance
        if fix is not None:
            seen = oracle.update(fix[:2])
            out = np.concatenate([part[2] for part in parts], axis=1)
            true = np.array([seen.nis, seen.log_determinant, seen.squared_residual])
            # A residual is known to within the rounding of a position, whatever its size.
            scale = np.maximum(1, np.abs(true))
            rows = np.array([lanes.NIS, lanes.LOG_DET, lanes.SQ_FIX]) - lanes.SUMS.start
            sums.append(np.max(np.abs(out[rows] - true) / scale, axis=0).astype(float))
            assert np.all(out[lanes.OK - lanes.SUMS.start] == 1.0), "a lane failed inside the box"
        wrong = covariance_error(new_covariance, oracle.covariance)
        shrunk = shrinkage(prior, oracle.covariance) if fix is not None else np.ones(len(padded))
        errors.append((mean_error(new_mean, oracle.mean), wrong, shrunk))
    n = len(table)
    return Stepwise(*(np.array(e)[:, :n] for e in zip(*errors, strict=True)), sums=np.array(sums)[:, :n])


def textbook(
    row: np.ndarray, *, theta_first: bool, redraw: bool = True, angles: Sequence[int] = ()
) -> UnscentedKalmanFilter:
    """The textbook filter for planar5, to be restarted before it is used."""
    points = SigmaPoints(*map(float, row[:3]), first=(THETA,) if theta_first else ())
    start = np.zeros(5), np.eye(5)
    return UnscentedKalmanFilter(
        planar5, gps_position(), *start, points, redraw_sigma_points=redraw, angles=angles
    )


def textbook_against_filterpy(
    timeline: Timeline,
    initial: InitialState,
    table: np.ndarray,
    n_steps: int | None = None,
    *,
    theta_first: bool,
    redraw: bool = True,
    angles: Sequence[int] = (),
) -> Stepwise:
    """One step at a time, restarted from FilterPy's trajectory."""
    errors = []
    for row in table:
        theirs = FilterPyUkf(row, theta_first=theta_first, redraw=redraw)
        theirs.restart(initial.mean, initial.covariance)
        ours = textbook(row, theta_first=theta_first, redraw=redraw, angles=angles)
        pairs = []
        for i, fix in steps_with_fixes(timeline, n_steps):
            ours.mean, ours.covariance = theirs.mean.copy(), theirs.covariance.copy()
            imu = np.array([timeline.ax[i], timeline.ay[i], timeline.gz[i]])
            ours.predict(timeline.dt[i], imu, np.diag(row[3:8]) * timeline.q_scale[i])
            if fix is not None:
                ours.update(fix[:2], np.diag(row[8:]))
            theirs.step(timeline, i, fix)
            prior = theirs.covariance if fix is None else theirs.ukf.P_prior
            pairs.append((ours.mean, ours.covariance, theirs.mean, theirs.covariance, prior))
        mean, covariance, their_mean, their_covariance, priors = map(np.array, zip(*pairs, strict=True))
        errors.append(
            (
                mean_error(mean, their_mean),
                covariance_error(covariance, their_covariance),
                shrinkage(priors, their_covariance),
            )
        )
    return Stepwise(*(np.array(e).T for e in zip(*errors, strict=True)))


@dataclass(frozen=True, eq=False)
class FreeRun:
    """One set, free running: distance of the compiled means (n, at IMU samples) from FilterPy's and a twin's."""

    filterpy: np.ndarray
    filterpy_covariance: np.ndarray
    twin: np.ndarray

    @property
    def judged(self) -> np.ndarray:
        """Up to where the twin has never been farther away than TWIN_LIMIT."""
        return np.maximum.accumulate(self.twin) < TWIN_LIMIT


def free_run(
    timeline: Timeline, initial: InitialState, row: np.ndarray, n_steps: int | None = None
) -> FreeRun:
    """The compiled filter, FilterPy with the same root of P, and the compiled twin with its heading moved."""
    theirs = FilterPyUkf(row, theta_first=True)
    theirs.restart(initial.mean, initial.covariance)
    states = []
    for i, fix in steps_with_fixes(timeline, n_steps):
        theirs.step(timeline, i, fix)
        if timeline.sampled[i]:
            states.append((theirs.mean, theirs.covariance))
    their_mean, their_covariance = map(np.array, zip(*states, strict=True))
    n = len(states)
    ours, twin = (compiled_run(timeline, start, row) for start in (initial, moved(initial, TWIN_TURN)))
    return FreeRun(
        filterpy=mean_error(ours[0][:n], their_mean),
        filterpy_covariance=covariance_error(ours[1][:n], their_covariance),
        twin=mean_error(twin[0][:n], ours[0][:n]),
    )


def compiled_run(timeline: Timeline, initial: InitialState, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances of the compiled filter over the whole time line."""
    replay = Replay(timeline, initial, Targets.none(timeline))
    mean, covariance, sound = record_replay(replay, as_parameters(row[None])[0])
    assert sound.all(), "the compiled filter failed"
    return mean, covariance


def moved(initial: InitialState, turn: float) -> InitialState:
    """The same start with its heading moved by ``turn`` (rad)."""
    return replace(initial, mean=initial.mean + turn * np.eye(5)[THETA])


def with_gap(drive: Drive, start: float, length: float) -> Drive:
    """The drive with nothing recorded, by either sensor, for ``length`` s after ``start``."""
    imu, gps = (s.select(~((s.time > start) & (s.time < start + length))) for s in (drive.imu, drive.gps))
    return replace(drive, imu=imu, gps=gps, name=f"{drive.name} with a gap")


def simulated() -> Drive:
    """A minute on a curvy road, jittering clocks, and a gap of 1.6 s soon after the start."""
    drive = make_drive(duration=60, jitter=0.3, seed=7)
    return with_gap(drive, initial_state(drive).time + 2.0, 1.6)


# --- What the tests run on ---------------------------------------------------------------------------------

REAL = "kitti-09-30-0033"
GAPPY = "kitti-09-30-0018"  # 1.6 s without IMU samples


@cache
def ready(name: str) -> tuple[Timeline, InitialState]:
    if name == "simulated":
        drive = simulated()
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the reader's, about gaps
            drive = read_drive(DRIVES / name)
    initial = initial_state(drive)
    return build_timeline(drive, initial.time), initial


WHOLE_DRIVES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="takes minutes without the compiler")
EACH_DRIVE = pytest.mark.parametrize("name", ["simulated", pytest.param(REAL, marks=needs_shared)])


def ordinary(n: int, seed: int = 1) -> np.ndarray:
    """Sets of the box with alpha >= 0.1, where doubles bear the weights of the textbook form."""
    table = box_table(32 + n, seed)[-n:]
    table[:, 0] = np.maximum(table[:, 0], 0.1)
    return table


# --- Step by step ------------------------------------------------------------------------------------------


@EACH_DRIVE
def test_compiled_filter_takes_the_oracles_steps_everywhere_in_the_box(name: str):
    timeline, initial = ready(name)
    errors = compiled_against_extended(timeline, initial, box_table(64), 700)
    assert np.max(timeline.dt[:700]) > (1.5 if name == "simulated" else 0.06)  # a gap is among them
    assert timeline.absorbs[:700].sum() > 25
    # At the first fix after the long gap a handful of sets loses up to 12 digits of a variance: no more than they
    # must. Everywhere else it is 1e-9 and much less.
    assert errors.beyond(1e-9, margin=1).max() < 1
    assert errors.mean[errors.shrunk < 1e8].max() < 1e-9
    assert errors.mean.max() < 1e-7
    assert np.mean(errors.covariance > 1e-9) < 2e-4
    assert np.quantile(errors.covariance, 0.99) < 1e-11
    assert np.quantile(errors.mean, 0.99) < 1e-12
    assert errors.sums is not None
    assert errors.sums.max() < 1e-9


@pytest.mark.parametrize("theta_first", [False, True], ids=["plain root", "theta first"])
@pytest.mark.parametrize("redraw", [True, False], ids=["redrawn", "propagated"])
@EACH_DRIVE
def test_textbook_filter_takes_filterpys_steps(name: str, theta_first: bool, redraw: bool):
    timeline, initial = ready(name)
    corners = box_table(32)[[4, 7, 12, 15, 20, 23, 28, 31]]  # alpha = 1
    table = np.vstack([ordinary(6), corners])
    errors = textbook_against_filterpy(timeline, initial, table, 230, theta_first=theta_first, redraw=redraw)
    assert np.max(timeline.dt[:230]) > (1.5 if name == "simulated" else 0.06)
    assert errors.mean.max() < 1e-10
    # P - K S K^T and sigma points beside tens of metres lose digits on both sides where R is tiny beside P.
    assert errors.covariance[errors.shrunk < 100].max() < 1e-10
    assert errors.beyond(1e-10, margin=5000).max() < 1
    assert np.quantile(errors.covariance, 0.9) < 1e-11


def test_offsets_of_more_than_half_a_turn_are_kept():
    # With kappa = 5 and 10 rad2 per step a sigma point lies several turns away from the centre. Newton's
    # equations do not mind, neither FilterPy nor the compiled filter wraps, so the textbook's filter must not.
    timeline, initial = ready("simulated")
    errors = textbook_against_filterpy(
        timeline, initial, box_table(32)[[20, 23, 28, 31]], 60, theta_first=True, angles=(THETA,)
    )
    assert errors.mean.max() < 1e-10
    assert errors.beyond(1e-10, margin=5000).max() < 1


@pytest.mark.parametrize("alpha", [1e-3, 1e-2])
def test_sigma_points_and_weights_give_the_covariance_back(alpha: float):
    _, initial = ready("simulated")
    points = SigmaPoints(alpha, 2.0, 0.0, first=(THETA,))
    wm, _ = points.weights(5)
    offsets = points.draw(np.zeros(5), initial.covariance)
    assert covariance_error((offsets.T * wm) @ offsets, initial.covariance) < 1e-14
    assert wm.sum() == pytest.approx(1.0, abs=1e-9)


def test_offsets_across_the_seam_of_an_angle_are_wrapped():
    # A process that wraps its heading: the centre stays at one side of +-pi, some sigma points land on the other.
    def wrapping(state: np.ndarray, dt: float, imu: np.ndarray) -> np.ndarray:
        new = planar5(state, dt, imu)
        new[THETA] = np.arctan2(np.sin(new[THETA]), np.cos(new[THETA]))
        return new

    _, initial = ready("simulated")
    points = SigmaPoints(0.5, 2.0, 0.0, first=(THETA,))
    filters = [
        UnscentedKalmanFilter(f, gps_position(), initial.mean, initial.covariance, points, angles=(THETA,))
        for f in (planar5, wrapping)
    ]
    for ukf in filters:
        ukf.mean[THETA] = np.pi - 1e-3
        ukf.predict(0.01, np.array([1.0, 0.5, 0.05]), 1e-4 * np.eye(5))
    assert mean_error(filters[1].mean, filters[0].mean) < 1e-14
    assert covariance_error(filters[1].covariance, filters[0].covariance) < 1e-10


def test_a_run_adds_up_its_steps():
    # The oracle checks single steps; a run is these in a row, bit for bit, and its sums are theirs.
    timeline, initial = ready("simulated")
    n, table = 600, box_table(48)[32:]
    constants = pack_constants(as_parameters(table), timeline.nominal_interval)
    mean, covariance = (
        np.tile(initial.mean, (lanes.LANES, 1)),
        np.tile(initial.covariance, (lanes.LANES, 1, 1)),
    )
    means, total = [], np.zeros((lanes.N_SUMS, lanes.LANES))
    for i, fix in steps_with_fixes(timeline, n):
        mean, covariance, sums = compiled_step(timeline, i, fix, mean, covariance, constants)
        total += sums
        if timeline.sampled[i]:
            means.append(mean)
    n_fixes = int(timeline.absorbs[:n].sum())
    assert n_fixes > 8
    assert n_fixes % 8  # the product of det S is moved into its logarithm after every 8, and at the end
    first = {
        name: getattr(timeline, name)[:n]
        for name in (
            "end",
            "dt",
            "ax",
            "ay",
            "gz",
            "q_scale",
            "absorbs",
            "hides",
            "sampled",
            "cornering",
            "sample",
        )
    }
    start = replace(
        timeline, **first, fixes=timeline.fixes[:n_fixes], imu_time=timeline.imu_time[: len(means)]
    )
    whole = run_replay(Replay(start, initial, Targets.none(start)), as_parameters(table))
    assert whole.nis == pytest.approx(total[lanes.NIS - lanes.SUMS.start], rel=1e-12)
    assert whole.log_determinant == pytest.approx(total[lanes.LOG_DET - lanes.SUMS.start], rel=1e-12)
    assert whole.squared_fix == pytest.approx(total[lanes.SQ_FIX - lanes.SUMS.start], rel=1e-12)
    for lane, row in enumerate(table):
        assert compiled_run(start, initial, row)[0].tobytes() == np.array(means)[:, lane].tobytes()


# --- Free running ------------------------------------------------------------------------------------------


@WHOLE_DRIVES
@EACH_DRIVE
def test_free_run_stays_with_filterpy_where_a_twin_stays(name: str):
    # Where moving the heading by 1e-13 has never moved the mean by 1e-12, rounding is amplified little, and the
    # two filters' own rounding, some 1e-14 to 1e-11 a step at alpha >= 0.1, must stay as small.
    timeline, initial = ready(name)
    runs = [free_run(timeline, initial, row, 1000) for row in ordinary(10)]
    judged = [run.filterpy[run.judged] for run in runs]
    assert np.mean([run.judged.all() for run in runs]) > 0.5
    assert np.quantile(np.concatenate(judged), 0.5) < 1e-10
    assert np.quantile(np.concatenate(judged), 0.9) < 1e-9
    assert max(part.max(initial=0.0) for part in judged) < 1e-8
    assert max(run.filterpy_covariance[run.judged].max(initial=0.0) for run in runs) < 1e-7


@WHOLE_DRIVES
@EACH_DRIVE
def test_no_lane_fails_inside_the_box(name: str):
    timeline, initial = ready(name)
    every_corner = np.array(list(product((0, 1), repeat=10)))
    table = np.vstack([np.where(every_corner, UPPER, LOWER), box_table(1032)[32:]])
    sums = run_replay(Replay(timeline, initial, Targets.none(timeline)), as_parameters(table))
    assert not sums.failed.any()
    assert np.isfinite(sums.log_determinant).all()
    for row in box_table(48):
        compiled_run(timeline, initial, row)  # looks at every covariance along the way


# --- Where the model is linear -----------------------------------------------------------------------------


def kalman_filter(timeline: Timeline, initial: InitialState, row: np.ndarray) -> np.ndarray:
    """x, y, vx, vy (n, 4) and their covariance (n, 4, 4) of the linear filter that knows its heading."""
    x, p = initial.mean[:4].copy(), initial.covariance[:4, :4].copy()
    theta, identity, states = float(initial.mean[THETA]), np.eye(2), []
    h = np.eye(4)[:2]
    for i, fix in steps_with_fixes(timeline):
        dt = timeline.dt[i]
        f = np.block([[identity, dt * identity], [0 * identity, identity]])
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        acceleration = turn @ [timeline.ax[i], timeline.ay[i]]
        x = f @ x + np.concatenate([acceleration * dt**2 / 2, acceleration * dt])
        p = f @ p @ f.T + np.diag(row[3:7]) * timeline.q_scale[i]
        theta += timeline.gz[i] * dt
        if fix is not None:
            s = h @ p @ h.T + np.diag(row[8:])
            gain = p @ h.T @ np.linalg.inv(s)
            x = x + gain @ (fix[:2] - h @ x)
            p = (np.eye(4) - gain @ h) @ p @ (np.eye(4) - gain @ h).T + gain @ np.diag(row[8:]) @ gain.T
        if timeline.sampled[i]:
            states.append(np.concatenate([x, p.ravel()]))
    return np.array(states)


@WHOLE_DRIVES
@pytest.mark.parametrize("alpha", [1e-3, 0.1, 1.0])
def test_with_a_known_heading_it_is_the_kalman_filter(alpha: float):
    timeline, initial = ready("simulated")
    known = initial.covariance.copy()
    known[THETA], known[:, THETA] = 0.0, 0.0
    known[THETA, THETA] = 1e-28
    initial = replace(initial, covariance=known)
    row = np.array([alpha, 2.0, 1.0, 1e-3, 2e-3, 3e-3, 4e-3, 1e-30, 0.5, 2.0])
    mean, covariance = compiled_run(timeline, initial, row)
    exact = kalman_filter(timeline, initial, row)
    scale = np.maximum(1, np.abs(exact))
    ours = np.hstack([mean[:, :4], covariance[:, :4, :4].reshape(-1, 16)])
    assert np.max(np.abs(ours - exact) / scale) < 1e-11
