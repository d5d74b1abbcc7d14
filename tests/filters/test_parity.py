"""Compare the compiled filter, the textbook filter, FilterPy, and an oracle in extended precision.

tests/stepwise.py describes the comparison and the reason for single steps. The tests use parts of drives, and
benchmarks/parity.py uses whole drives.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import product
from typing import Any

import numba
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from filter_cases import KINDS
from free_running import compiled_run, free_run
from oracles.box import LOWER, UPPER, as_parameters, box_sets, box_table, weighed
from oracles.extended import THETA, covariance_error, mean_error
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.events import FIX, LATERAL, STANDSTILL, VELOCITY, events_of
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.models import gps_position, planar5
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets, run_passes
from sigmaswarm.filters.run import run_filter, run_textbook
from sigmaswarm.filters.starts import measured_by
from sigmaswarm.filters.textbook import SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.geodesy import wrap_angle
from stepwise import (
    REAL,
    SIMULATED,
    CompiledCars,
    compiled_against_extended,
    equipped,
    on_time_line,
    ready,
    simulated,
    some_steps,
    steps_with_fixes,
    textbook_against_filterpy,
)
from support import make_drive, needs_shared, quickly, timeline_of

WHOLE_DRIVES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="takes minutes without the compiler")
ALSO_LONG = pytest.mark.parametrize(
    "name", [SIMULATED, pytest.param(REAL, marks=[needs_shared, pytest.mark.long])]
)
PLANAR = ("planar5", "planar8")


def at_stops(
    filters: Iterable[tuple[str, ...]], here: Callable[[str, str], bool] = lambda model, kind: True
) -> list[Any]:
    """Return filters with a simulated drive with stops, and one with a recording; `make test-long` runs all on both."""
    return [
        pytest.param(
            *case,
            name,
            marks=[needs_shared] * real
            + [pytest.mark.long] * (case != ("planar8", "ekf") if real else not here(*case)),
        )
        for case in filters
        for name, real in (("urban", False), ("colorado", True))
    ]


EACH_MODEL = pytest.mark.parametrize("model", PLANAR)


def ordinary(n: int, seed: int = 1) -> np.ndarray:
    """Return parameter sets with alpha >= 0.1, for which double precision is sufficient in the textbook form."""
    table = box_table(32 + n, seed)[-n:]
    table[:, 0] = np.maximum(table[:, 0], 0.1)
    return table


def happens_at(timeline: Timeline, p: FilterParameters, bit: int, n_steps: int | None = None) -> int:
    """Count the steps that end with this measurement."""
    return int(np.sum(events_of(timeline, measured_by(p)).flags[:n_steps] & bit != 0))


# --- Compiled against the oracle, step by step -------------------------------------------------------------


@ALSO_LONG
def test_compiled_steps_equal_the_oracle_everywhere_in_the_papers_bounds(name: str):
    timeline, initial = ready(name)
    errors = compiled_against_extended(timeline, initial, as_parameters(box_table(64)), until=700)
    assert np.max(timeline.dt[:700]) > (1.5 if name == SIMULATED else 0.06)  # the steps include a gap
    assert timeline.updates[:700].sum() > 25
    assert np.isfinite(errors.turn).all(), "a lane failed within the bounds"
    # At the first fix after the long gap, rounding costs a few sets up to 12 digits of a variance, which is inevitable.
    # All other errors are below 1e-9, except in the long step of a set whose heading is unknown.
    assert errors.beyond(2e-9, margin=1).max() < 1
    assert errors.mean[errors.shrunk < 1e8].max() < 1e-9
    assert errors.mean.max() < 1e-7
    assert np.mean(errors.covariance > 1e-9) < 2e-4
    assert np.quantile(errors.covariance, 0.99) < 1e-11
    assert np.quantile(errors.mean, 0.99) < 1e-12
    assert errors.sums is not None
    assert errors.sums.max() < 1e-9


@pytest.mark.parametrize(
    ("model", "kind", "name"),
    at_stops(
        product((*PLANAR, "tilted12"), KINDS),
        lambda model, kind: model == "planar8" or (model, kind) in (("planar5", "ukf"), ("tilted12", "ekf")),
    ),
)
def test_every_compiled_filter_agrees_with_the_oracle_for_all_measurements(model: str, kind: str, name: str):
    timeline, initial = ready(name)
    sets = box_sets(model, kind, 32)
    for bit in (FIX, VELOCITY, LATERAL, STANDSTILL):
        assert happens_at(timeline, sets[0], bit) > 30
    errors = compiled_against_extended(timeline, initial, sets, some_steps(timeline, sets, 20))
    known = errors.known
    assert known.mean() > 0.4
    # Only a strong tracking filter whose heading is wrong by many turns may fail.
    failed = np.isinf(errors.turn).any(axis=0).sum()
    assert failed <= (1 if kind == "strong-tracking-ukf" else 0)
    assert errors.mean[known].max() < 1e-9
    # The factor of strong tracking comes from a difference of traces and sometimes loses one or two digits.
    limit = 1e-8 if kind == "strong-tracking-ukf" else 1e-9
    assert errors.beyond(limit, margin=1)[known].max() < 1
    assert np.quantile(errors.covariance[known], 0.999) < 1e-9
    assert np.quantile(errors.covariance[known], 0.99) < 1e-10
    assert errors.sums is not None
    assert errors.sums[known[errors.absorbed]].max() < 1e-9
    if kind in ("adaptive-ukf", "fuzzy-ukf"):
        assert errors.noise is not None
        assert errors.noise[known[errors.absorbed]].max() < 1e-9
    # If the heading is unknown, rounding errors are amplified; most covariances still agree to 1e-8.
    lost = ~known & np.isfinite(errors.turn)
    assert not lost.any() or np.quantile(errors.covariance[lost], 0.9) < 1e-8


@pytest.mark.parametrize(
    ("model", "kind", "name"),
    at_stops(
        product((*PLANAR, "tilted12"), ("ukf", "ekf")),
        lambda *case: case in (("planar8", "ukf"), ("tilted12", "ekf")),
    ),
)
def test_filters_that_weight_fixes_agree_with_the_oracle(model: str, kind: str, name: str):
    timeline, initial = ready(name)
    timeline = replace(timeline, fixes=straying(timeline))
    sets = weighed(box_sets(model, kind, 32))
    steps = some_steps(timeline, sets, 20) | set(np.flatnonzero(timeline.updates)[::2].tolist())
    errors = compiled_against_extended(timeline, initial, sets, steps)
    known = errors.known
    assert known.mean() > 0.4
    assert np.isfinite(errors.turn).all()
    assert errors.mean[known].max() < 1e-9
    assert errors.beyond(1e-9, margin=1)[known].max() < 1
    assert np.quantile(errors.covariance[known], 0.99) < 1e-10
    assert errors.sums is not None and errors.weight is not None
    assert errors.sums[known[errors.absorbed]].max() < 1e-9
    weight = errors.weight[known[errors.absorbed]]
    assert min(np.mean(weight < 0.25), np.mean(weight > 0.9)) > 0.1
    assert errors.recovered is not None and errors.recovered.any()


def straying(timeline: Timeline) -> np.ndarray:
    """Return fixes with outliers of all sizes and a jump that lasts to the end, so that some filters recover."""
    fixes, n = timeline.fixes.copy(), len(timeline.fixes)
    fixes[::5, 0] += 60.0 * np.sin(np.arange(0, n, 5))
    fixes[timeline.fix_time > timeline.end[-1] - 8.0, 1] += 200.0
    return fixes


# --- FilterPy, step by step --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "theta_first", "redraw"),
    [
        pytest.param(SIMULATED, False, False, id="none"),
        pytest.param(SIMULATED, False, True, id="redraw", marks=pytest.mark.long),
        pytest.param(SIMULATED, True, False, id="heading first", marks=pytest.mark.long),
        pytest.param(SIMULATED, True, True, id="both", marks=pytest.mark.long),
        pytest.param(REAL, True, True, id="recording", marks=[needs_shared, pytest.mark.long]),
    ],
)
def test_textbook_steps_agree_with_filterpy(name: str, theta_first: bool, redraw: bool):
    timeline, initial = ready(name)
    corners = box_table(32)[[4, 15, 20, 31]]  # alpha = 1
    sets = as_parameters(np.vstack([ordinary(2), corners]))
    errors = textbook_against_filterpy(
        timeline, initial, sets, until=230, theta_first=theta_first, redraw=redraw
    )
    assert np.max(timeline.dt[:230]) > (1.5 if name == SIMULATED else 0.06)
    assert errors.mean.max() < 1e-10
    # If R is small relative to P and positions are tens of meters, both forms lose digits in P - K S K^T.
    assert errors.covariance[errors.shrunk < 100].max() < 1e-10
    assert errors.beyond(1e-10, margin=5000).max() < 1
    assert np.quantile(errors.covariance, 0.9) < 1e-11


@pytest.mark.parametrize(
    ("model", "kind", "name"),
    at_stops(product(PLANAR, ("ukf", "ekf")), lambda *case: case == ("planar5", "ukf")),
)
def test_textbook_steps_agree_with_filterpy_for_all_measurements(name: str, model: str, kind: str):
    timeline, initial = ready(name)
    sets = [replace(p, alpha=max(p.alpha, 0.1), gate=None) for p in box_sets(model, kind, 2, seed=2)]
    steps = some_steps(timeline, sets, 20)
    errors = textbook_against_filterpy(timeline, initial, sets, steps, theta_first=False)
    assert errors.known.mean() > 0.4
    assert errors.mean[errors.known].max() < 1e-10
    assert errors.covariance[errors.known & (errors.shrunk < 100)].max() < 1e-10
    assert errors.beyond(1e-10, margin=5000)[errors.known].max() < 1


def test_offsets_of_more_than_half_a_turn_are_kept():
    # With kappa = 5 and 10 rad2 per step, a sigma point is several turns away from the mean. FilterPy and the compiled
    # filter do not wrap such offsets, so the textbook filter must not wrap them.
    timeline, initial = ready(SIMULATED)
    sets = as_parameters(box_table(32)[[20, 23, 28, 31]])
    errors = textbook_against_filterpy(timeline, initial, sets, until=60, theta_first=True)
    assert errors.turn.max() > np.pi
    assert errors.mean.max() < 1e-10
    assert errors.beyond(1e-10, margin=5000).max() < 1


@pytest.mark.parametrize("alpha", [1e-3, 1e-2])
def test_sigma_points_and_weights_reproduce_the_covariance(alpha: float):
    _, initial = ready(SIMULATED)
    points = SigmaPoints(alpha, 2.0, 0.0, first=(THETA,))
    wm, _ = points.weights(5)
    offsets = points.draw(np.zeros(5), initial.covariance)
    assert covariance_error((offsets.T * wm) @ offsets, initial.covariance) < 1e-14
    assert wm.sum() == pytest.approx(1.0, abs=1e-9)


def test_offsets_across_pi_are_wrapped():
    # For a process that wraps its heading, the mean stays on one side of +-pi, and some sigma points are on the other.
    def wrapping(state: np.ndarray, dt: float, imu: np.ndarray) -> np.ndarray:
        new = planar5(state, dt, imu)
        new[THETA] = np.arctan2(np.sin(new[THETA]), np.cos(new[THETA]))
        return new

    _, initial = ready(SIMULATED)
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


@EACH_MODEL
@pytest.mark.parametrize("kind", ["ukf", "ekf"])
def test_a_run_is_the_sequence_of_its_steps(kind: str, model: str):
    # The oracle checks single steps; a run consists of these steps, bit for bit, and its sums are their sums.
    timeline, initial = on_time_line(equipped(simulated()))
    n = 600
    sets = [replace(p, gate=None) for p in box_sets(model, kind, LANES)]
    compiled, flags = CompiledCars(timeline, initial, sets), events_of(timeline, measured_by(sets[0])).flags
    means, total = [], np.zeros((3, LANES))
    for i, fix in steps_with_fixes(timeline, n):
        compiled.step(i, int(flags[i]), fix, since=0.0)
        total += compiled.sums[:3]
        if timeline.sampled[i]:
            means.append(compiled.state[0])
    n_fixes = int(timeline.updates[:n].sum())
    assert n_fixes > 8
    assert n_fixes % 8  # the product of det S of 8 fixes is added to its logarithm, and the rest at the end
    start = first_steps(timeline, n)
    whole = run_passes([FilterPass(start, initial, Targets.none(start))], sets)
    assert whole["NIS"][0] == pytest.approx(total[0], rel=1e-12)
    assert whole["LOG_DET"][0] == pytest.approx(total[1], rel=1e-12)
    assert whole["SQ_FIX"][0] == pytest.approx(total[2], rel=1e-12)
    stepped = np.array(means)
    stepped[..., THETA] = wrap_angle(stepped[..., THETA])  # estimates contain wrapped headings
    for lane, p in enumerate(sets):
        assert compiled_run(start, initial, p)[0].tobytes() == stepped[:, lane].tobytes()


def first_steps(timeline: Timeline, n: int) -> Timeline:
    first = {
        name: getattr(timeline, name)[:n]
        for name in (
            "end",
            "steps",
            "updates",
            "hides",
            "sampled",
            "sample",
        )
    }
    fixes, samples = (int(getattr(timeline, name)[:n].sum()) for name in ("updates", "sampled"))
    imu = timeline.drive.imu.select(timeline.drive.imu.time <= timeline.imu_time[samples - 1])
    return replace(timeline, **first, fixes=timeline.fixes[:fixes], drive=replace(timeline.drive, imu=imu))


# --- Free running ------------------------------------------------------------------------------------------


@pytest.mark.long
@WHOLE_DRIVES
@pytest.mark.parametrize("name", [SIMULATED, pytest.param(REAL, marks=[needs_shared, pytest.mark.long])])
def test_a_free_run_agrees_with_filterpy_where_a_perturbed_run_agrees(name: str):
    # Where moving the heading by 1e-13 moves the mean by less than 1e-12, rounding is amplified little. There, the
    # rounding errors of the two filters, 1e-14 to 1e-11 per step at alpha >= 0.1, must stay small.
    timeline, initial = ready(name)
    runs = [free_run(timeline, initial, p, 1000) for p in as_parameters(ordinary(5))]
    judged = [run.filterpy[run.judged] for run in runs]
    assert np.mean([run.judged.all() for run in runs]) > 0.5
    assert np.quantile(np.concatenate(judged), 0.5) < 1e-10
    assert np.quantile(np.concatenate(judged), 0.9) < 1e-9
    assert max(part.max(initial=0.0) for part in judged) < 1e-8
    assert max(run.filterpy_covariance[run.judged].max(initial=0.0) for run in runs) < 1e-7


@WHOLE_DRIVES
@ALSO_LONG
def test_no_lane_fails_within_the_bounds(name: str):
    timeline, initial = ready(name)
    every_corner = np.array(list(product((0, 1), repeat=10)))
    table = np.vstack([np.where(every_corner, UPPER, LOWER), box_table(1032)[32:]])
    sums = run_passes([FilterPass(timeline, initial, Targets.none(timeline))], as_parameters(table))
    assert not sums.failed.any()
    assert np.isfinite(sums["LOG_DET"]).all()
    for p in as_parameters(box_table(48)):
        compiled_run(timeline, initial, p)  # checks every covariance


# --- Linear models ---------------------------------------------------------------------------------------


def kalman_filter(timeline: Timeline, initial: InitialState, row: np.ndarray) -> np.ndarray:
    """Return x, y, vx, vy and their covariance (n, 20) of the linear filter with a known heading."""
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
@pytest.mark.parametrize("alpha", quickly([(1e-3,), (0.1,), (1.0,)], lambda alpha: alpha == 0.1))
def test_with_a_known_heading_it_is_the_kalman_filter(alpha: float):
    drive = simulated()
    initial = initial_state(drive)
    timeline = timeline_of(drive, initial.time, as_recorded=True)  # gaps add no uncertainty
    known = initial.covariance.copy()
    known[THETA], known[:, THETA] = 0.0, 0.0
    known[THETA, THETA] = 1e-28
    initial = replace(initial, covariance=known)
    row = np.array([alpha, 2.0, 1.0, 1e-3, 2e-3, 3e-3, 4e-3, 1e-30, 0.5, 2.0])
    mean, covariance = compiled_run(timeline, initial, as_parameters(row[None])[0])
    exact = kalman_filter(timeline, initial, row)
    scale = np.maximum(1, np.abs(exact))
    ours = np.hstack([mean[:, :4], covariance[:, :4, :4].reshape(-1, 16)])
    assert np.max(np.abs(ours - exact) / scale) < 1e-11


@pytest.mark.parametrize("alpha", [1e-3, 0.5])
@pytest.mark.parametrize("kind", ["ukf", "ekf"])
def test_for_a_coasting_car_every_filter_equals_the_kalman_filter(kind: str, alpha: float):
    # Without acceleration, the heading has no effect, so the equations are linear in all five states.
    drive = make_drive(duration=20, jitter=0.3, seed=3)
    timeline, initial = on_time_line(drive)
    coasting = replace(drive, imu=replace(drive.imu, ax=0 * drive.imu.ax, ay=0 * drive.imu.ay))
    p = FilterParameters(
        alpha, 2.0, 1.0, (1e-4, 2e-4, 3e-3, 4e-3, 1e-5), (0.5, 2.0), kind=kind, velocity_noise=0.3
    )
    kalman, means, covariances = KalmanFilter(dim_x=5, dim_z=2), [], []
    kalman.x, kalman.P, kalman.R, kalman.H = (
        initial.mean,
        initial.covariance,
        np.diag([0.5, 2.0]),
        np.eye(2, 5),
    )
    for i, fix in steps_with_fixes(timeline):
        dt = timeline.dt[i]
        kalman.F[[0, 1], [2, 3]] = dt
        turn = np.array([0, 0, 0, 0, timeline.gz[i] * dt])
        kalman.predict(u=turn, B=np.eye(5), Q=np.diag(p.process_noise) * timeline.q_scale[i])
        if fix is not None:
            kalman.update(fix[:2])
        if timeline.sampled[i]:
            means.append(kalman.x)
            covariances.append(kalman.P)
    filters = [run_filter(coasting, p, initial=initial, recover=False)]
    if alpha == 0.5:  # at 1e-3, the textbook's weights of 1e6 leave ten digits
        filters.append(run_textbook(coasting, p, initial=initial))
    for estimate in filters:
        assert mean_error(estimate.mean, np.array(means)).max() < 1e-12
        assert covariance_error(estimate.covariance, np.array(covariances)).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_planar8_with_known_biases_equals_planar5_for_all_measurements(kind: str):
    timeline, initial = ready("urban")
    drive = timeline.drive
    five = replace(box_sets("planar5", kind, 5)[4], kappa=3.0, process_noise=(1e-4, 1e-4, 1e-3, 1e-3, 1e-6))
    assert five.standstill_noise is not None
    eight = replace(
        five, model="planar8", kappa=0.0, process_noise=(*five.process_noise, 0.0, 0.0, 0.0),
        bias_std=(1e-10, 1e-10),
    )  # fmt: skip
    initial = replace(initial, gyro=None)  # otherwise, the bias has an uncertainty
    a, b = (
        run_filter(drive, five, initial=initial, recover=False),
        run_filter(drive, eight, initial=initial, recover=False),
    )
    assert mean_error(b.mean[:, :5], a.mean).max() < 1e-9
    assert covariance_error(b.covariance[:, :5, :5], a.covariance).max() < 1e-9
    assert np.max(np.abs(b.mean[:, 5:])) < 1e-9
