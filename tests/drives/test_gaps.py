"""Gaps in the IMU: their detection, and the growth of P."""

import numpy as np
import pytest

from sigmaswarm.drives.gaps import gaps_before
from sigmaswarm.filters.constants import GAP_ACCELERATION_STD, GAP_TURN_STD, gap_covariance


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 1000.0])
def test_an_interval_of_more_than_five_is_a_gap_if_it_is_long_enough(rate: float):
    for missing in (3, 5, 9, 60, 200):
        time = np.arange(400.0) / rate
        time = np.delete(time, slice(150, 150 + missing))
        length = (missing + 1) / rate
        gaps = gaps_before(time)
        assert np.flatnonzero(gaps).tolist() == ([150] if length > max(5.0 / rate, 0.05) else [])
        if gaps.any():
            assert gaps.max() == pytest.approx(length, rel=1e-9)


def test_irregular_times_are_no_gaps_and_a_lower_rate_is_adopted():
    rng = np.random.default_rng(0)
    assert not gaps_before(np.cumsum(rng.uniform(0.005, 0.045, 2000))).any()
    slower = np.concatenate([np.arange(200) * 0.01, 2.0 + np.arange(100) * 0.2])
    assert 0 < np.count_nonzero(gaps_before(slower)) < 30


@pytest.mark.parametrize("pieces", [1, 2, 7])
def test_the_growth_is_that_of_one_unseen_motion(pieces: int):
    # The whole gap adds (sigma T)^2 to heading and velocity, independent of the fixes in the gap.
    gap, parts = 1.6, np.random.default_rng(pieces).dirichlet(np.ones(pieces)) * 1.6
    total = sum((gap_covariance(8, dt, gap) for dt in parts), np.zeros((8, 8)))
    assert total[4, 4] == pytest.approx((GAP_TURN_STD * gap) ** 2)
    assert total[2, 2] == total[3, 3] == pytest.approx((GAP_ACCELERATION_STD * gap) ** 2)
    assert np.linalg.eigvalsh(total).min() > -1e-15
    one = gap_covariance(5, 0.5, gap)
    assert one[0, 0] == pytest.approx(one[2, 2] * 0.5**2 / 4)
    assert one[1, 3] == pytest.approx(one[3, 3] * 0.5 / 2)
    assert not gap_covariance(5, 0.5, 0.0).any()
