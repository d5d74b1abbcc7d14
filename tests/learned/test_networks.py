"""Networks that assist a filter: new networks change no bit; trained networks equal the textbook equations."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from filter_cases import equipped, parameters
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.filters.run import run_filter, whole_pass
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.learned import outage_lstm
from sigmaswarm.learned.displacements import Displacements, DisplacementStart, body_displacement
from sigmaswarm.learned.fitting import gru, head, lstm, new_weights
from sigmaswarm.learned.noise_gru import FEATURES, MAX_SCALE, NoiseRun
from sigmaswarm.learned.outage_lstm import OutageLstm, OutageRun, new_network
from support import hide_fixes, make_drive, quickly

AXES = ("ax", "ay", "gz", "az", "gx", "gy")


@cache
def silent() -> Drive:
    """Return a drive without fixes from 20 to 40 s."""
    return hide_fixes(make_drive(duration=60.0), [[20.0, 40.0]])


def network(seed: int = 0, **more) -> OutageLstm:
    rng = np.random.default_rng(seed)
    moved = rng.normal([9.0, 0.0], [3.0, 0.3], (50, 2))
    made = new_network(rng, AXES, 6.0, 5, rng.normal(size=(50, outage_lstm.WINDOW_STEPS, 12)), moved)
    return replace(made, **more)


@pytest.mark.parametrize("recover", [True, False])
def test_without_an_outage_no_bit_changes(recover: bool):
    drive, p = equipped(), parameters("planar8", lateral_noise=0.05)
    plain = FilterRun(whole_pass(drive), p, recover=recover).whole()
    for pieces in (7, 10_000):
        for run in (
            OutageRun(whole_pass(drive), p, network(), samples=pieces, recover=recover),
            NoiseRun(whole_pass(drive), p, _unlearned(), samples=pieces, recover=recover),
        ):
            whole = run.whole()
            assert whole.mean.tobytes() == plain.mean.tobytes()
            assert whole.covariance.tobytes() == plain.covariance.tobytes()


@pytest.mark.parametrize("model", ["planar8", "tilted12"])
def test_in_an_outage_pieces_give_the_bits_of_the_whole(model: str):
    p = parameters(model, lateral_noise=0.05)
    one, many = (OutageRun(whole_pass(silent()), p, network(), samples=n) for n in (10_000, 33))
    assert one.whole().mean.tobytes() == many.whole().mean.tobytes()
    assert one.accepted + one.rejected == many.accepted + many.rejected == 19
    assert one.accepted > 0
    assert one.failure is None


def test_estimates_do_not_depend_on_later_fixes():
    p = parameters("planar8", lateral_noise=0.05)
    drive = silent()
    late = drive.gps.time > 45.0
    other = replace(drive, gps=replace(drive.gps, x=drive.gps.x + 9.0 * late))
    one, two = (OutageRun(whole_pass(d), p, network()).whole() for d in (drive, other))
    before = one.time < 45.0
    assert one.mean[before].tobytes() == two.mean[before].tobytes()
    assert one.mean.tobytes() != two.mean.tobytes()


def test_an_infinite_inflation_changes_no_bit_of_the_filter():
    p = parameters("planar8")
    run = OutageRun(whole_pass(silent()), p, replace(network(), inflation=np.inf, unsure=10.0))
    assert run.whole().mean.tobytes() == run_filter(silent(), p).mean.tobytes()


def displaced(
    p: FilterParameters, drive_pass: FilterPass, first: int = 1500
) -> tuple[FilterRun, DisplacementStart, int, Displacements]:
    """Return a run at the end of 100 samples, the displacement's start, the next step, and the displacement updates."""
    begins, stop = (int(np.flatnonzero(drive_pass.timeline.sampled)[k]) + 1 for k in (first, first + 100))
    run = FilterRun(drive_pass, p)
    run._steps_to(begins, np.empty((0, 0, 0)))
    start = DisplacementStart(run._rows[0].copy(), run._cursor.copy())
    run._steps_to(stop, np.empty((0, 0, 0)))
    return run, start, stop, Displacements(drive_pass, p)


@pytest.mark.parametrize(
    ("model", "kind", "lateral_noise"),
    # planar5 without lateral determines the direction in each step, unless the state has been turned by another program
    quickly(
        [
            ("planar8", "ekf", 0.05),
            ("planar5", "ukf", 0.05),
            ("planar5", "ekf", None),
            ("tilted12", "ekf", 0.05),
        ],
        lambda model, kind, lateral_noise: model != "tilted12",
    ),
)
def test_the_update_with_a_displacement_equals_that_of_a_filter_with_a_clone(
    model: str, kind: str, lateral_noise: float | None
):
    """Compare with a joint update that uses numerical derivatives of the textbook filter."""
    p = parameters(model, kind=kind, lateral_noise=lateral_noise)
    drive_pass = whole_pass(silent())
    line, first = drive_pass.timeline, int(np.flatnonzero(drive_pass.timeline.sampled)[1200]) + 1
    run, begin, stop, on = displaced(p, drive_pass, 1200)
    (x0, p0), (x1, p1) = on._state(begin.rows), on._state(run._rows[0])
    plus, minus = on._plus, on._minus

    def propagated(state: np.ndarray) -> np.ndarray:
        car = TextbookCar(line, p, drive_pass.initial)
        car.filter.mean, car.filter.covariance = state.copy(), p0.copy()
        for step in range(first, stop):
            car.step(step)
        return car.filter.mean

    steps = 1e-3 * np.sqrt(np.diag(p0))
    ahead = np.array([minus(propagated(plus(x0, e)), propagated(x0)) for e in np.diag(steps)]).T / steps
    n = len(x0)
    joint = np.block([[p0, p0 @ ahead.T], [ahead @ p0, p1]])
    h = np.zeros((2, 2 * n))
    at = body_displacement(x0, x1)
    for i in range(n):
        e = 1e-6 * np.eye(n)[i]
        h[:, i] = (body_displacement(plus(x0, e), x1) - at) / 1e-6
        h[:, n + i] = (body_displacement(x0, plus(x1, e)) - at) / 1e-6
    noise = np.diag([0.04, 0.09])
    s = h @ joint @ h.T + noise
    gain = joint @ h.T @ np.linalg.inv(s)
    innovation = np.array([0.3, -0.1])
    rows = run._rows[0].copy()
    assert on.update(begin, rows, stop, at + innovation, noise)
    mean, covariance = on._state(rows)
    assert not rows[R.SIN_COS_VALID].any()
    wanted = (joint - gain @ s @ gain.T)[n:, n:]
    scale = np.sqrt(np.diag(p1))
    np.testing.assert_allclose(minus(mean, plus(x1, gain[n:] @ innovation)) / scale, 0.0, atol=2e-3)
    np.testing.assert_allclose((covariance - wanted) / np.outer(scale, scale), 0.0, atol=2e-3)
    assert not on.update(begin, rows, stop, at + 1e3, noise)  # rejected as an outlier


def test_a_displacement_does_not_determine_the_absolute_position():
    """Even with an accurate displacement, the final position is not more certain than the initial position."""
    run, begin, stop, on = displaced(parameters("planar8", lateral_noise=0.05), whole_pass(silent()))
    (x0, p0), (x1, _) = on._state(begin.rows), on._state(run._rows[0])
    assert on.update(begin, run._rows[0], stop, body_displacement(x0, x1), 1e-6 * np.eye(2))
    assert np.linalg.eigvalsh(on._state(run._rows[0])[1][:2, :2])[1] > 0.9 * np.linalg.eigvalsh(p0[:2, :2])[1]


def test_an_update_that_increases_the_residual_is_rejected():
    """If heading and velocity are very uncertain, the model is not linear, and the update may increase the residual."""
    run, begin, stop, on = displaced(parameters("planar8", lateral_noise=0.05), whole_pass(silent()))
    rows = run._rows[0]
    (x0, _), (x1, _) = on._state(begin.rows), on._state(rows)
    for each in (begin.rows, rows):
        each[R.TT] = 0.1
        each[[R.UU, R.VV]] += 100.0
    forward, left = body_displacement(x0, x1)
    before = rows.copy()
    for turn in (0.3, 1.0, 2.0):
        c, s = np.cos(turn), np.sin(turn)
        moved = np.array([c * forward - s * left, s * forward + c * left])
        assert not on.update(begin, rows, stop, moved, 1e-2 * np.eye(2))
        assert rows.tobytes() == before.tobytes()


def test_features_are_means_and_standard_deviations():
    """Compare with each step's samples, evaluated one by one."""
    drive = make_drive(duration=40.0)
    line = whole_pass(drive).timeline
    end = np.array([2000, 2500])
    found = outage_lstm.features_at(line, end, axes=("ay", "gz"), window=8.0)
    for k, sample in enumerate(end):
        edges = line.imu_time[sample] + np.linspace(-8.0, 0.0, outage_lstm.WINDOW_STEPS + 1)
        for j in (0, 20, outage_lstm.WINDOW_STEPS - 1):
            fine = np.linspace(edges[j], edges[j + 1], 2001)
            for column, axis in enumerate(("ay", "gz")):
                values = np.interp(fine, drive.imu.time, getattr(drive.imu, axis))
                assert found[k, j, column] == pytest.approx(values.mean(), abs=1e-4)
                assert np.exp(found[k, j, 2 + column]) == pytest.approx(values.std(), rel=0.05, abs=2e-3)


def test_outages_are_detected_after_a_delay():
    line = whole_pass(silent()).timeline
    found = outage_lstm.outage_windows(line, axes=AXES, window=6.0)
    time, last = line.imu_time, line.end[line.updates]
    before = last[np.searchsorted(last, time[found.end], side="right") - 1]
    assert (time[found.end] - before >= outage_lstm.OUTAGE_AFTER).all()
    np.testing.assert_allclose(time[found.end] - time[found.begin], outage_lstm.HORIZON, atol=0.0101)
    assert (found.begin[1:] == found.end[:-1]).all()
    assert len(found.over) == 1
    assert time[found.over[0]] >= 40.0


def test_a_drive_without_an_axis_is_rejected():
    drive = silent()
    bare = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
    with pytest.raises(InputError, match=r"synthetic: imu.csv has no az, an input of the network"):
        OutageRun(whole_pass(bare), parameters("planar8"), network())


def _unlearned(units: int = 4) -> dict[str, np.ndarray]:
    return new_weights(np.random.default_rng(0), 3, FEATURES, units, 2)


def test_noise_scales_start_after_the_first_fix_and_are_within_bounds():
    weights = {**_unlearned(), "head": 9.0 * np.random.default_rng(1).normal(size=(4, 2))}
    drive, p = equipped(), parameters("planar8")
    run = NoiseRun(whole_pass(drive), p, weights).finished()
    scales = np.array(run.scales)
    assert len(scales) == len(run.innovations.time)
    assert (scales >= 1 / MAX_SCALE).all()
    assert (scales <= MAX_SCALE * (1 + 1e-12)).all()
    assert np.ptp(np.log(scales)) > 0.3
    plain = FilterRun(whole_pass(drive), p).finished().innovations
    assert run.innovations.covariance[0].tobytes() == plain.covariance[0].tobytes()
    assert run.innovations.covariance[1].tobytes() != plain.covariance[1].tobytes()


def test_cells_agree_with_their_equations():
    """Compute the cells element by element, as in the papers."""
    rng = np.random.default_rng(3)
    x, h, c = rng.normal(size=3), rng.normal(size=2), rng.normal(size=2)
    w = {k: rng.normal(size=v.shape) for k, v in new_weights(rng, 4, 3, 2, 1).items()}

    def logistic(v: np.ndarray) -> np.ndarray:
        return 1 / (1 + np.exp(-v))

    def gate(k: int) -> np.ndarray:
        own = slice(2 * k, 2 * k + 2)
        return w["input"][:, own].T @ x + w["hidden"][:, own].T @ h + w["bias"][own]

    kept = logistic(gate(1)) * c + logistic(gate(0)) * np.tanh(gate(2))
    new_h, new_c = lstm(np, w, (h, c), x)
    np.testing.assert_allclose(new_c, kept)
    np.testing.assert_allclose(new_h, logistic(gate(3)) * np.tanh(kept))
    w = {k: rng.normal(size=v.shape) for k, v in new_weights(rng, 3, 3, 2, 1).items()}
    r, z = logistic(gate(0)), logistic(gate(1))
    of_h = w["hidden"][:, 4:6].T @ h
    new = np.tanh(gate(2) - of_h + r * of_h)
    np.testing.assert_allclose(gru(np, w, h, x), (1 - z) * new + z * h)
    np.testing.assert_allclose(head(w, h), h @ w["head"] + w["head_bias"])


def test_hidden_fixes_cause_an_outage_too():
    """A pass that hides fixes, to score predictions, has the outage of a drive without these fixes."""
    drive, p = make_drive(duration=60.0), parameters("planar8")
    ready = PreparedDrive(drive)
    line = ready.timeline(hidden_fixes(drive.gps.time, [[20.0, 40.0]]))
    run = OutageRun(FilterPass(line, ready.initial, Targets.none(line)), p, network()).finished()
    assert run.accepted + run.rejected == 19
