from datetime import UTC, datetime

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.importing.dates import GPS_EPOCH, LEAP_SECONDS, gps_to_unix
from sigmaswarm.importing.expressions import time_expression


def seconds(*date: int) -> float:
    return datetime(*date, tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("date", "leaps"),
    [
        ((1980, 1, 7), 0),
        ((1990, 6, 1), 6),
        ((2000, 1, 1), 13),
        ((2010, 1, 1), 15),
        ((2016, 12, 31), 17),
        ((2017, 1, 2), 18),
        ((2026, 1, 1), 18),
    ],
)
def test_leap_seconds_are_those_of_gps_receivers(date: tuple[int, ...], leaps: int):
    """GPS - UTC, as receivers state it (u-blox NAV-TIMELS, USNO)."""
    assert seconds(*date) - gps_to_unix(np.array([seconds(*date)]))[0] == leaps
    assert datetime.fromtimestamp(GPS_EPOCH, UTC) == datetime(1980, 1, 6, tzinfo=UTC)


@given(st.floats(3.2e8, 2e9))
def test_gps_time_never_runs_backwards_but_at_a_leap(time: float):
    before, after = gps_to_unix(np.array([time, time + 5.0]))
    near = np.abs(LEAP_SECONDS - before).min() < 60
    assert after - before == pytest.approx(5.0, abs=1.1 if near else 1e-6)


@given(st.integers(0, 4_000_000_000_000_000_000))
def test_integers_keep_all_their_digits(ns: int):
    frame = pl.DataFrame({"stamp": [ns]}, schema={"stamp": pl.UInt64})
    assert frame.select(time_expression("stamp*1e-9", frame)).item() == ns
    assert frame.select(time_expression("stamp/1000000000", frame)).item() == ns


def test_dates_of_a_table():
    moment = datetime(2024, 2, 29, 12, 0, 0, 250_000)
    frame = pl.DataFrame({"when": [moment]})
    wanted = 1_709_208_000_250_000_000
    assert frame.select(time_expression("when", frame)).item() == wanted
    assert frame.select(time_expression("utc(when)", frame)).item() == pytest.approx(wanted, abs=500)
