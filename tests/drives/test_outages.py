"""Outages: the windows have the required distances and all allowed positions, and end at an IMU sample."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sigmaswarm.drives.outages import hidden_fixes, random_windows, snap_ends
from sigmaswarm.errors import InputError
from support import DRIVES, hide_fixes, make_drive, needs_shared

EPS = 1e-9
seconds = st.floats(0, 30)
lengths = st.one_of(
    st.floats(0.5, 8), st.tuples(st.floats(0.5, 8), st.floats(0, 8)).map(lambda p: (p[0], p[0] + p[1]))
)
placements = {
    "start": st.floats(-1e3, 1e3),
    "duration": st.floats(0, 400),
    "seed": st.integers(0, 2**32),
    "length": lengths,
    "first_after": seconds,
    "apart": seconds,
    "count": st.one_of(st.none(), st.integers(0, 20)),
}


def draw(start: float, duration: float, seed: int, **options) -> np.ndarray:
    options = {"length": (3.0, 5.0), "first_after": 10.0} | options
    return random_windows(start, start + duration, np.random.default_rng(seed), **options)


def test_both_ends_of_a_window_are_hidden():
    time = np.array([0.9, 1.0, 1.5, 2.0, 2.1, 5.0])
    np.testing.assert_array_equal(hidden_fixes(time, [[1.0, 2.0], [5.0, 6.0]]), [0, 1, 1, 1, 0, 1])
    assert not hidden_fixes(time, np.empty((0, 2))).any()


@given(
    st.lists(st.floats(-10, 10), max_size=20),
    st.lists(st.tuples(st.integers(-9, 9), st.integers(0, 5)), max_size=8),
)
def test_a_fix_is_hidden_if_any_window_contains_it(time: list[float], windows: list[tuple[int, int]]):
    """Independent of the order of the windows; windows may overlap or have zero length."""
    spans = [(float(start), float(start + length)) for start, length in windows]
    time = [*time, *(end for span in spans for end in span), float("nan")]
    found = hidden_fixes(time, np.array(spans).reshape(-1, 2))
    assert found.tolist() == [any(start <= t <= end for start, end in spans) for t in time]


def test_hiding_fixes_changes_nothing_else():
    drive = make_drive(duration=20.0)
    hidden = hide_fixes(drive, [[5.0, 8.0]])
    assert hidden.imu is drive.imu
    assert hidden.truth is drive.truth
    assert len(drive.gps) - len(hidden.gps) == 15  # 5 Hz for 3 s
    assert not np.any((hidden.gps.time >= 5) & (hidden.gps.time <= 8))
    np.testing.assert_array_equal(hidden.gps.x, drive.gps.x[(drive.gps.time < 5) | (drive.gps.time > 8)])


@given(**placements)
def test_windows_have_the_required_distances(
    length, first_after: float, apart: float, count: int | None, **where
):
    windows = draw(length=length, first_after=first_after, apart=apart, count=count, **where)
    start, end = where["start"], where["start"] + where["duration"]
    shortest, longest = length if isinstance(length, tuple) else (length, length)
    assert windows.shape[1:] == (2,)
    assert count is None or len(windows) <= count
    if len(windows):
        assert windows[0, 0] >= start + first_after - EPS
        assert windows[-1, 1] <= end
        assert np.all(windows[1:, 0] - windows[:-1, 1] >= apart - EPS)
        assert np.all(windows[:, 1] - windows[:, 0] >= shortest - EPS)
        assert np.all(windows[:, 1] - windows[:, 0] <= longest + EPS)
    elif count != 0:
        assert where["duration"] - first_after < longest + EPS  # no window only if none fits


@given(st.integers(1, 20), st.floats(0, 500), st.integers(0, 99))
def test_the_requested_number_of_windows_if_they_fit(count: int, slack: float, seed: int):
    needed = 10 + 5 * count + 5 * (count - 1)
    assert len(draw(0.0, needed + slack + EPS, seed, length=5.0, count=count)) == count
    assert len(draw(0.0, needed - EPS, seed, length=5.0, count=count)) == count - 1


def test_rounding_never_moves_a_window_past_the_end():
    rng = np.random.default_rng(0)
    for start, length in zip(rng.uniform(0, 30, 500), rng.uniform(0.5, 8, 500), strict=True):
        end = start + 10 + length  # room for one window without slack, up to rounding
        assert np.all(random_windows(start, end, rng, length=length, first_after=10.0, count=1)[:, 1] <= end)


def test_about_one_per_fifteen_seconds_by_default():
    assert len(draw(0.0, 310.0, 0)) == 20
    assert len(draw(0.0, 15.1, 0, length=5.0)) == 1
    assert draw(0.0, 14.9, 0, length=5.0).shape == (0, 2)


def test_the_same_seed_gives_the_same_windows():
    np.testing.assert_array_equal(draw(0.0, 300.0, 7), draw(0.0, 300.0, 7))
    assert not np.array_equal(draw(0.0, 300.0, 7), draw(0.0, 300.0, 8))


def test_every_admissible_placement_is_equally_likely():
    """The position of one window is uniform; with two windows, the slack before the first is Beta(1, 2)."""
    rng = np.random.default_rng(0)
    one = [random_windows(0, 65.0, rng, length=5.0, first_after=10.0, count=1)[0, 0] for _ in range(2000)]
    assert stats.kstest(one, stats.uniform(10, 50).cdf).pvalue > 1e-3
    two = np.array(
        [random_windows(0, 65.0, rng, length=5.0, first_after=10.0, count=2)[:, 0] for _ in range(2000)]
    )
    assert stats.kstest((two[:, 0] - 10) / 40, stats.beta(1, 2).cdf).pvalue > 1e-3
    assert stats.kstest((two[:, 1] - 20) / 40, stats.beta(2, 1).cdf).pvalue > 1e-3


def test_lengths_are_uniform_in_their_range():
    windows = draw(0.0, 30_000.0, 0)
    assert stats.kstest(windows[:, 1] - windows[:, 0], stats.uniform(3, 2).cdf).pvalue > 1e-3


def irregular_clock(duration: float, seed: int) -> np.ndarray:
    """Return IMU times with jitter and a few gaps of seconds."""
    rng = np.random.default_rng(seed)
    interval = 0.05 * rng.uniform(0.2, 1.8, int(duration / 0.05)) + 3 * (
        rng.random(int(duration / 0.05)) < 0.002
    )
    return np.cumsum(interval)


@given(st.integers(0, 2**32), st.floats(0, 10), st.integers(1, 20), lengths)
def test_snapped_windows_end_on_samples_and_have_the_required_distances(
    seed: int, apart: float, count: int, length
):
    clock = irregular_clock(100.0, seed)
    rng = np.random.default_rng(seed)
    windows = random_windows(
        clock[0], clock[-1], rng, length=length, first_after=10.0, apart=apart, count=count
    )
    snapped = snap_ends(windows, clock, apart=apart)
    assert np.isin(snapped[:, 1], clock).all()
    assert np.all(snapped[1:, 0] - snapped[:-1, 1] >= apart - EPS)
    np.testing.assert_allclose(snapped, naively_snapped(windows, clock, apart), atol=EPS)
    if len(snapped):
        assert snapped[0, 0] >= windows[0, 0] - EPS  # only later, so the first window keeps its distance
        assert (
            len(snapped) == len(windows) or clock[-1] - snapped[-1, 1] < apart + np.ptp(windows, axis=1).max()
        )


def naively_snapped(windows: np.ndarray, clock: np.ndarray, apart: float) -> np.ndarray:
    """Try every sample in order; use the last sample if none fits."""
    snapped: list[list[float]] = []
    for start, end in windows:
        length = end - start
        roomy = [t for t in clock if not snapped or t - length >= snapped[-1][1] + apart]
        chosen = [t for t in roomy if t >= end][:1] or [t for t in roomy if t == clock[-1]]
        snapped += [[t - length, t] for t in chosen]
    return np.array(snapped).reshape(-1, 2)


def test_a_window_past_the_last_sample_moves_earlier_or_is_omitted():
    clock = np.arange(101) * 0.1
    np.testing.assert_allclose(snap_ends([[8.0, 11.0]], clock), [[7.0, 10.0]])
    np.testing.assert_allclose(
        snap_ends([[1.0, 2.0], [8.0, 11.0]], clock, apart=5.0), [[1.0, 2.0], [7.0, 10.0]]
    )
    np.testing.assert_allclose(snap_ends([[1.0, 3.0], [8.0, 11.0]], clock, apart=5.0), [[1.0, 3.0]])
    late = [[1.0, 3.0], [8.0, 11.0], [9.5, 9.6]]  # the last window fits after the second is omitted
    np.testing.assert_allclose(snap_ends(late, clock, apart=5.0), [[1.0, 3.0], [9.5, 9.6]])
    assert snap_ends(np.empty((0, 2)), clock).shape == (0, 2)


def test_an_end_on_a_sample_stays():
    clock = np.arange(1001) * 0.01
    windows = np.array([[clock[100], clock[300]]])
    np.testing.assert_array_equal(snap_ends(windows, clock)[:, 1], windows[:, 1])


@pytest.mark.parametrize(
    "options", [{"length": 0.0}, {"length": (5.0, 3.0)}, {"apart": -1.0}, {"first_after": -1.0}]
)
def test_impossible_requests(options):
    with pytest.raises(InputError, match="can't be drawn; use a positive length"):
        draw(0.0, 100.0, 0, **options)


@needs_shared
def test_windows_on_a_real_clock():
    from sigmaswarm.drives.reader import read_drive

    drive = read_drive(DRIVES / "dresden")
    t = drive.imu.time
    windows = snap_ends(
        random_windows(t[0], t[-1], np.random.default_rng(1), length=5.0, first_after=10.0), t
    )
    assert len(windows) == 14
    assert np.isin(windows[:, 1], t).all()
    hidden = hide_fixes(drive, windows)
    assert 0.25 < 1 - len(hidden.gps) / len(drive.gps) < 0.4
    assert all(b[0] - a[1] >= 5 - EPS for a, b in pairwise(windows))
