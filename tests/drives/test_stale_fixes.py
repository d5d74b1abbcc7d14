"""Stale fixes: planted in drives, also with static hold, and compared with a simple form of the rule."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Gps
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.stale_fixes import HELD, NEW, STALE, STALE_MOVING, classify_fixes, stale_fixes
from support import DRIVES, make_drive, needs_shared


def repeated(gps: Gps, rows: slice) -> Gps:
    """Return the fixes, some of them repeated from the previous fix."""
    x, y = gps.x.copy(), gps.y.copy()
    x[rows], y[rows] = x[rows.start - 1], y[rows.start - 1]
    return replace(gps, x=x, y=y)


def straight(speed, rate: float = 5.0, duration: float = 20.0) -> Gps:
    """Simulate a car that drives east with ``speed(t)``, m/s, and a receiver without noise."""
    t = np.arange(0.0, duration, 1 / rate)
    fine = np.linspace(0.0, duration, 20001)
    way = np.concatenate([[0.0], np.cumsum(np.diff(fine) * speed(fine[1:]))])
    return Gps(time=t, x=np.interp(t, fine, way), y=np.zeros(len(t)))


@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("speed", [2.5, 8.0, 30.0])
def test_repeats_of_a_driving_car_are_stale_and_no_evidence(rate: float, speed: float):
    gps = straight(lambda t: speed + 0 * t, rate)
    first = int(8 * rate)
    kinds = classify_fixes(repeated(gps, slice(first, first + 4)))
    expected = np.full(len(gps), NEW)
    expected[first : first + 4] = STALE_MOVING
    assert kinds.tolist() == expected.tolist()


@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("braking", [1.0, 2.0, 3.5])
def test_repeated_fixes_at_a_red_light_are_static_hold(rate: float, braking: float):
    gps = straight(lambda t: np.clip(12.0 - braking * (t - 5.0), 0.0, 12.0), rate)
    stopped = int(np.ceil((5.0 + 12.0 / braking) * rate)) + 1
    kinds = classify_fixes(repeated(gps, slice(stopped, len(gps))))
    assert (kinds[: stopped - 1] == NEW).all()
    assert (kinds[stopped:] == HELD).all()


def test_repeats_after_an_impossible_braking_are_stale():
    # As on kingston-1: steps of 14.8 m and 8.4 m in 1 s each, then repeats, while the car continued at 13 m/s.
    x = np.cumsum([13.0, 13.5, 14.8, 8.35, 0.0, 0.0, 31.0, 14.0])
    kinds = classify_fixes(Gps(np.arange(8.0), x, np.zeros(8)))
    assert kinds.tolist() == [NEW] * 4 + [STALE_MOVING] * 2 + [NEW] * 2


def test_between_crawling_and_driving_a_repeat_is_stale_but_may_be_evidence():
    gps = straight(lambda t: 1.4 + 0 * t)
    assert (classify_fixes(repeated(gps, slice(40, 44)))[40:44] == STALE).all()


def test_a_series_of_repeats_is_classified_at_its_beginning():
    gps = straight(lambda t: 10.0 + 0 * t, duration=120.0)
    assert (classify_fixes(repeated(gps, slice(100, 590)))[100:590] == STALE_MOVING).all()
    still = straight(lambda t: 0.0 * t, duration=60.0)
    assert (classify_fixes(still)[1:] == HELD).all()  # a log that begins with repeats begins at standstill


@pytest.mark.parametrize("shift", [0.0, 0.06], ids=["one clock", "two clocks"])
def test_two_receivers_are_each_compared_with_themselves(shift: float):
    gps = straight(lambda t: 10.0 + 0 * t)
    other = replace(repeated(gps, slice(50, 53)), time=gps.time + shift, y=gps.y + 1.5)
    time = np.concatenate([gps.time, other.time])
    order = np.argsort(time, kind="stable")
    both = Gps(time[order], np.concatenate([gps.x, other.x])[order], np.concatenate([gps.y, other.y])[order])
    frozen = np.flatnonzero(stale_fixes(both))
    assert both.y[frozen].tolist() == [1.5] * 3
    assert frozen.tolist() == [101, 103, 105]


def test_one_position_at_one_time_is_not_a_repeat():
    gps = straight(lambda t: 10.0 + 0 * t)
    twice = Gps(np.repeat(gps.time, 2), np.repeat(gps.x, 2), np.repeat(gps.y, 2))
    assert not classify_fixes(twice).any()


def test_repeats_between_new_positions_are_stale():
    # A log at 10 Hz of a receiver at 1 Hz: nine of ten fixes are repeats.
    gps = straight(lambda t: 6.0 + 0 * t, rate=10.0)
    held = replace(gps, x=gps.x[np.arange(len(gps)) // 10 * 10])
    moving = held.time >= 2.0
    assert (stale_fixes(held) == (np.arange(len(gps)) % 10 != 0))[moving].all()


def plainly(gps: Gps) -> list[bool]:
    """Return whether each fix repeats an earlier fix of the last 3 s (or the last fix)."""
    found: list[bool] = []
    for k, t in enumerate(gps.time):
        before = [j for j in range(k) if gps.time[j] < t]
        seen = [j for j in before if gps.time[j] >= t - 3.0] + before[-1:]
        found.append(any(gps.x[j] == gps.x[k] and gps.y[j] == gps.y[k] for j in seen))
    return found


@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2), st.integers(0, 1)), min_size=1, max_size=30),
    st.integers(0, 29),
)
def test_repeats_are_found_causally(rows: list[tuple[int, int, int]], cut: int):
    steps, x, y = np.array(rows, dtype=float).T
    gps = Gps(np.cumsum(steps * 0.4), 7.0 * x, 7.0 * y)
    kinds = classify_fixes(gps)
    assert (kinds != NEW).tolist() == plainly(gps)
    assert classify_fixes(gps.select(slice(0, cut))).tolist() == kinds[:cut].tolist()


def test_the_alignment_does_not_use_stale_fixes():
    drive = make_drive(duration=20.0, gps_std=0.3, seed=2)
    start = initial_state(drive)
    first = int(np.searchsorted(drive.gps.time, start.time))
    stuck = replace(drive, gps=repeated(drive.gps, slice(first - 3, first + 1)))
    moved = initial_state(stuck)
    assert moved.time > start.time
    gone = np.isin(np.arange(len(drive.gps)), range(first - 3, first + 1))
    without = initial_state(replace(drive, gps=drive.gps.select(~gone)))
    assert moved.time == without.time
    assert moved.mean.tobytes() == without.mean.tobytes()
    assert initial_state(stuck, as_recorded=True).mean.tobytes() != moved.mean.tobytes()


def test_hidden_fixes_are_classified_with_all_others():
    drive = make_drive(duration=30.0, seed=4)
    stuck = replace(drive, gps=repeated(drive.gps, slice(100, 110)))
    ready = PreparedDrive(stuck)
    hidden = np.isin(np.arange(len(drive.gps)), range(95, 105))
    assert ready.stale.sum() == 10
    assert (ready.timeline(hidden, removed=True).kinds >= STALE).sum() == 5  # their originals are removed
    assert not PreparedDrive(stuck, as_recorded=True).stale.any()


@needs_shared
def test_kingston_has_18_stale_fixes():
    drive = read_drive(DRIVES / "kingston-1")
    kinds = classify_fixes(drive.gps)
    assert (kinds == STALE_MOVING).sum() == 18
    assert (kinds >= STALE).sum() == 18
