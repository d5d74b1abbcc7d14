"""The odometer in every form of the filter: oracle, textbook, compiled, live."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from filter_cases import OPTIONS, equipped, parameters
from oracles.box import box_sets
from oracles.box import wheeled as with_odometer
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive, Odometer
from sigmaswarm.drives.events import ODOMETER, STANDSTILL, events_of
from sigmaswarm.drives.odometer import INTERVAL, SLOW
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.run import run_filter, run_textbook
from stepwise import compiled_against_extended, on_time_line, some_steps, urban, wheeled
from support import quickly, sparse, timeline_of

WHEELS = {"odometer_noise": 0.01, "odometer_scale": 1.02, "odometer_latency": 0.04}
ALL = {**OPTIONS["all"], **WHEELS}


@cache
def driven() -> Drive:
    return wheeled(equipped())


@cache
def town() -> tuple[Timeline, InitialState]:
    return on_time_line(wheeled(urban()))


@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(
        product(("planar5", "planar8", "tilted12"), ("ukf", "ekf")),
        lambda model, kind: (model, kind) in (("planar8", "ukf"), ("tilted12", "ekf")),
    ),
)
def test_the_compiled_filter_agrees_with_the_oracle(model: str, kind: str):
    timeline, initial = town()
    sets = with_odometer(box_sets(model, kind, 32))
    steps = some_steps(timeline, sets, 20)
    flags = events_of(timeline, {"velocity", "lateral", "standstill", "odometer"}).flags
    assert sum(bool(flags[i] & ODOMETER) for i in steps) > 30
    errors = compiled_against_extended(timeline, initial, sets, steps)
    known = errors.known
    assert known.mean() > 0.4
    assert errors.mean[known].max() < 1e-9
    assert errors.beyond(1e-9, margin=1)[known].max() < 1
    assert np.quantile(errors.covariance[known], 0.99) < 1e-10


@pytest.mark.parametrize("model", ["planar5", "planar8", "tilted12"])
def test_the_textbook_agrees_with_the_run(model: str):
    p, start, drive = parameters(model, **ALL), initial_state(driven()), sparse(driven())
    run, textbook = (
        run_filter(drive, p, initial=start, recover=False),
        run_textbook(drive, p, initial=start),
    )
    np.testing.assert_allclose(run.mean, textbook.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.covariance, textbook.covariance, rtol=1e-7, atol=1e-12)
    without = run_filter(drive, replace(p, odometer_noise=None), initial=start, recover=False)
    assert np.max(np.abs(run.mean - without.mean)[:, 2:4]) > 0.01


@pytest.mark.parametrize("late", [0.0, 0.004, 0.35])
@pytest.mark.parametrize("model", ["planar5", "planar8", "tilted12"])
def test_the_live_filter_agrees_with_the_run(model: str, late: float):
    drive, start = driven(), initial_state(driven())
    p, (gps, imu, wheels) = parameters(model, **ALL), (drive.gps, drive.imu, drive.odometer)
    assert gps.speed is not None and gps.course is not None and wheels is not None
    lever = [*drive.lever_arm, drive.antenna_height]
    live = LiveFilter(p, start, nominal_interval=drive.nominal_interval, lever_arm=lever)
    events = [(t, 2, i) for i, t in enumerate(imu.time)] + [(t, 0, i) for i, t in enumerate(gps.time)]
    known = wheels.time + late <= imu.time[-1]
    events += [(wheels.time[i] + late, 1, i) for i in np.flatnonzero(known)]
    for t, what, i in sorted(events):
        if what == 2:
            live.predict(t, [getattr(imu, axis)[i] for axis in MODELS[p.model].imu])
        elif what == 1:
            live.update_odometer(wheels.time[i], wheels.speed[i])
        else:
            v = gps.speed[i] * np.array([np.cos(gps.course[i]), np.sin(gps.course[i])])
            live.update(t, (gps.x[i], gps.y[i]), v)
    run = run_filter(replace(drive, odometer=wheels.select(known)), p, initial=start)
    np.testing.assert_allclose(live.state.mean, run.mean[-1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(live.state.covariance, run.covariance[-1], rtol=1e-9, atol=1e-14)
    assert live.too_late == live.time_jumps == 0


def test_readings_that_a_live_filter_ignores():
    start, p = initial_state(driven()), parameters("planar5", **WHEELS)
    live = LiveFilter(p, start, nominal_interval=0.01, history=0.5)
    t = start.time + 0.01 * np.arange(1, 200)
    for now in t:
        live.predict(now, (0.0, 0.0, 0.0))
    assert live.update_odometer(t[-1] + 0.001, 8.0)
    assert not live.update_odometer(t[-1] + 0.001, 8.0)  # the same reading again
    assert not live.update_odometer(t[-1] - 1.0, 8.0) and live.too_late == 1
    assert not live.update_odometer(t[-1], np.nan) and live.too_late == 2
    assert not live.update_odometer(t[-1] + 11.0, 8.0) and live.time_jumps == 1
    assert not LiveFilter(parameters("planar5"), start, nominal_interval=0.01).update_odometer(t[0], 8.0)
    for i in range(20_000):  # more than the buffer holds while no IMU samples arrive
        live.update_odometer(t[-1] + 0.002 + 1e-4 * i, 8.0)
    assert live.too_late > 10_000
    live.predict(t[-1] + 0.01, (0.0, 0.0, 0.0))
    assert np.isfinite(live.state.mean).all()


def naive(odometer: Odometer, line: Timeline) -> list[tuple[float, ...]]:
    """Return the step's end, mean, age and addition to R of each measurement, as the module's docstring defines."""
    found, taken, last, slot = [], line.start, line.start, -1
    for t in line.end[line.sampled]:
        now = np.floor((t - line.start) / INTERVAL + 1e-6)
        if now != slot and any(max(last, t - INTERVAL) < r <= t for r in odometer.time):
            inside = [i for i, r in enumerate(odometer.time) if max(taken, t - INTERVAL) < r <= t]
            mean = sum(odometer.speed[i] for i in inside) / len(inside)
            age = sum(t - odometer.time[i] for i in inside) / len(inside)
            found.append((t, mean, age, SLOW**2 if abs(mean) < SLOW else 0.0))
            taken, slot = t, now
        last = t
    return found


@pytest.mark.parametrize("interval", [0.004, 0.012, 0.07, 0.31, 1.0])
@pytest.mark.parametrize("imu_rate", [10.0, 100.0])
def test_readings_are_averaged_as_documented(interval: float, imu_rate: float):
    rng = np.random.default_rng(7)
    keep = slice(None, None, round(100 / imu_rate))
    drive = clip_to(equipped(), 9.0, keep)
    time = np.arange(-0.5, 9.5, interval) + rng.uniform(
        0, 0.3 * interval, len(np.arange(-0.5, 9.5, interval))
    )
    odometer = Odometer(time, np.where(time > 7, 0.2, 5.0 + rng.standard_normal(len(time))))
    line = timeline_of(replace(drive, odometer=odometer), 3.0)
    found, wanted = events_of(line, {"odometer"}), naive(odometer, line)
    assert len(wanted) >= 5
    np.testing.assert_array_equal(line.end[found.flags & ODOMETER > 0], [row[0] for row in wanted])
    np.testing.assert_array_equal(found.wheels, [row[1:] for row in wanted])


def clip_to(drive: Drive, end: float, keep: slice) -> Drive:
    imu = drive.imu.select(drive.imu.time < end).select(keep)
    return replace(drive, imu=imu, gps=drive.gps.select(drive.gps.time < end))


def test_readings_of_slipping_wheels_are_rejected():
    drive = driven()
    assert drive.odometer is not None
    time, speed = drive.odometer.time, drive.odometer.speed
    spun = replace(drive, odometer=Odometer(time, np.where((time > 15) & (time < 18), 2.0 * speed, speed)))
    gone = replace(drive, odometer=drive.odometer.select((time <= 15) | (time >= 18)))
    p = parameters("planar8", **WHEELS)
    slipped, without = run_filter(spun, p).mean, run_filter(gone, p).mean
    assert np.abs(slipped - without)[:, 2:4].max() < 0.1  # the readings are 8 m/s too high
    absorbed = run_filter(spun, replace(p, odometer_noise=10.0)).mean  # with this R, they are not outliers
    assert np.abs(absorbed - without)[:, 2:4].max() > 0.5


def test_turning_wheels_prevent_a_standstill():
    timeline, _ = town()
    rests = events_of(timeline, {"standstill"}).flags & STANDSTILL > 0
    assert rests.sum() > 30
    odometer = timeline.drive.odometer
    assert odometer is not None
    turning = replace(odometer, speed=np.full(len(odometer), 3.0))
    moving = timeline_of(replace(timeline.drive, odometer=turning), timeline.start)
    assert not (events_of(moving, {"standstill", "odometer"}).flags & STANDSTILL).any()
    assert (events_of(moving, {"standstill"}).flags & STANDSTILL > 0).sum() == rests.sum()
    told = events_of(timeline, {"standstill", "odometer"}).flags & STANDSTILL > 0
    assert told.sum() > 0.8 * rests.sum()


def test_a_drive_without_an_odometer_is_refused():
    with pytest.raises(InputError, match=r"has no odometer\.csv; use a filter"):
        run_filter(equipped(), parameters("planar5", **WHEELS))
    with pytest.raises(InputError, match=r"has no odometer\.csv; use a filter"):
        run_textbook(equipped(), parameters("planar5", **WHEELS))
