"""Outliers: requested number, size and bursts; all other data are unchanged."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.errors import InputError
from sigmaswarm.simulation.gps import with_outliers
from support import make_drive

DRIVE = make_drive(duration=120.0)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 0.5), offset=st.floats(1.0, 100.0))
def test_the_requested_fraction_of_fixes_has_the_requested_error(seed: int, share: float, offset: float):
    far = with_outliers(DRIVE, np.random.default_rng(seed), share=share, offset=offset)
    moved = np.hypot(far.gps.x - DRIVE.gps.x, far.gps.y - DRIVE.gps.y)
    off = moved > 0
    np.testing.assert_allclose(moved[off], offset, rtol=1e-6)
    longest = 1.0 / np.median(np.diff(DRIVE.gps.time)) + 1  # number of fixes in a burst
    assert share <= off.mean() < share + longest / len(off)
    assert far.imu is DRIVE.imu and far.truth is DRIVE.truth
    again = with_outliers(DRIVE, np.random.default_rng(seed), share=share, offset=offset)
    assert again.gps.x.tobytes() == far.gps.x.tobytes()


def test_outliers_come_in_bursts_of_the_requested_length():
    far = with_outliers(DRIVE, np.random.default_rng(1), length=(2.0, 2.0))
    off = far.gps.x != DRIVE.gps.x
    starts = np.flatnonzero(np.diff(off.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(off.astype(int), append=0) == -1)
    spans = DRIVE.gps.time[ends] - DRIVE.gps.time[starts]
    assert len(spans) > 2
    assert spans.max() > 1.5
    single = with_outliers(DRIVE, np.random.default_rng(1), length=(0.0, 0.0))
    assert np.sum(single.gps.x != DRIVE.gps.x) >= 0.06 * len(off)


@pytest.mark.parametrize(
    "more", [{"share": 0.6}, {"share": -0.1}, {"length": (2.0, 1.0)}, {"length": (-1.0, 1.0)}]
)
def test_invalid_options_are_rejected(more):
    with pytest.raises(InputError, match="use a share of 0 to"):
        with_outliers(DRIVE, np.random.default_rng(0), **more)
