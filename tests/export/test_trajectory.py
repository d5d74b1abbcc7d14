"""Estimates as files: what is written can be read back, and is what the filter believed."""

import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.errors import InputError
from sigmaswarm.export.trajectory import check_target, write_estimate
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.run import Estimate, run_filter
from support import make_drive

STATES = ["x", "y", "vx", "vy", "theta"]
DRIVE = make_drive(duration=12.0)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return run_filter(DRIVE, DEFAULTS)


def test_csv_keeps_every_bit(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, tmp_path / "e.csv")
    frame = pl.read_csv(tmp_path / "e.csv")
    assert frame.columns == ["t", *STATES, *(f"std_{s}" for s in STATES)]
    assert frame["t"].to_numpy().tobytes() == estimate.time.tobytes()
    for i, state in enumerate(STATES):
        np.testing.assert_array_equal(frame[state], estimate.mean[:, i])
        expected = [math.sqrt(c[i][i]) for c in estimate.covariance]
        np.testing.assert_allclose(frame[f"std_{state}"], expected, rtol=1e-15)


def test_tum_has_time_place_and_quaternion(tmp_path: Path, estimate: Estimate):
    write_estimate(estimate, str(tmp_path / "e.tum"))
    lines = (tmp_path / "e.tum").read_text().splitlines()
    assert len(lines) == len(estimate.time)
    assert all(len(line.split(" ")) == 8 for line in lines)
    t, x, y, z, qx, qy, qz, qw = np.loadtxt(tmp_path / "e.tum").T
    np.testing.assert_allclose(t, estimate.time, atol=1e-9)
    np.testing.assert_allclose(np.column_stack([x, y]), estimate.mean[:, :2], atol=1e-6)
    assert not z.any()
    np.testing.assert_allclose(qx**2 + qy**2 + qz**2 + qw**2, 1.0, atol=1e-8)
    # the quaternion turns the x axis to where the car points
    np.testing.assert_allclose(1 - 2 * (qy**2 + qz**2), np.cos(estimate.mean[:, 4]), atol=1e-8)
    np.testing.assert_allclose(2 * (qx * qy + qz * qw), np.sin(estimate.mean[:, 4]), atol=1e-8)


def test_tum_of_a_quarter_turn(tmp_path: Path):
    one = Estimate(np.array([1.5]), np.array([[1.0, -2.0, 0, 0, math.pi / 2]]), np.eye(5)[None], _anywhere())
    write_estimate(one, tmp_path / "e.tum")
    half = f"{math.sqrt(0.5):.9f}"
    zero = "0.000000000"
    assert (
        tmp_path / "e.tum"
    ).read_text() == f"1.500000000 1.000000 -2.000000 0.000000 {zero} {zero} {half} {half}\n"


def _anywhere() -> InitialState:
    return InitialState(np.zeros(5), np.eye(5), 0.0)


def test_dead_reckoning_has_no_deviations_to_write(tmp_path: Path):
    estimate = run_imu_only(DRIVE)
    write_estimate(estimate, tmp_path / "e.csv")
    frame = pl.read_csv(tmp_path / "e.csv")
    assert frame.columns == ["t", *STATES]
    np.testing.assert_array_equal(frame["theta"], estimate.mean[:, 4])


@pytest.mark.parametrize("name", ["e.xls", "e", "e.CSV", "csv"])
def test_an_unknown_ending_is_refused(tmp_path: Path, estimate: Estimate, name: str):
    with pytest.raises(InputError, match=rf"{name}: can't tell the format; end the name in .csv or .tum"):
        write_estimate(estimate, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_can_not_be_written_is_refused(tmp_path: Path, estimate: Estimate):
    with pytest.raises(InputError, match="nowhere: no such folder; make it first"):
        check_target(tmp_path / "nowhere" / "e.csv")
    (tmp_path / "e.csv").mkdir()
    with pytest.raises(InputError, match=r"e.csv.* folder"):
        write_estimate(estimate, tmp_path / "e.csv")
