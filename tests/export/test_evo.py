"""The program evo computes from exported files the same errors as the library."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exported import tuned
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.trajectory import true_trajectory, write_estimate
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.scoring.evaluation import evaluate
from support import DRIVES, make_drive, needs_shared

PROGRAMS = Path(sys.executable).parent
needs_evo = pytest.mark.skipif(shutil.which("evo_ape", path=PROGRAMS) is None, reason="evo is not installed")


def evo(program: str, *arguments: object) -> float:
    """Return the RMSE that a program of evo prints."""
    environment = os.environ | {
        "HOME": str(Path(str(arguments[1])).parent),
        "MPLBACKEND": "agg",
    }  # the folder of its settings
    command = [PROGRAMS / program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr + done.stdout
    (rmse,) = re.findall(r"rmse\s+(\S+)", done.stdout)
    return float(rmse)


def written(drive: Drive, folder: Path, suffix: str) -> tuple[Estimate, Path, Path]:
    """Write the files of truth and of the estimate; return the estimate and both paths."""
    estimate = run_filter(drive, tuned("planar5", "ukf", drive.nominal_interval, everything=False))
    paths = folder / f"truth.{suffix}", folder / f"estimate.{suffix}"
    write_estimate(true_trajectory(drive), paths[0])
    write_estimate(estimate, paths[1])
    return estimate, *paths


def position_rmse(drive: Drive) -> float:
    p = tuned("planar5", "ukf", drive.nominal_interval, everything=False)
    return float(evaluate([drive], p).scores[drive.name]["tuned"].position_rmse)


@needs_evo
def test_ape_and_rpe_on_a_simulated_drive(tmp_path: Path):
    drive = make_drive(duration=30.0)
    estimate, truth_file, estimate_file = written(drive, tmp_path, "tum")
    assert evo("evo_ape", "tum", truth_file, estimate_file) == pytest.approx(position_rmse(drive), abs=2e-6)

    truth = drive.truth
    assert truth is not None
    at = np.searchsorted(truth.time, estimate.time)
    np.testing.assert_array_equal(truth.time[at], estimate.time)
    theirs = evo(
        "evo_rpe", "tum", truth_file, estimate_file, "--delta", 100, "--delta_unit", "f", "--all_pairs"
    )
    p = relative(estimate.mean[:, 0], estimate.mean[:, 1], estimate.mean[:, 4], 100)
    q = relative(truth.x[at], truth.y[at], truth.theta[at], 100)
    assert theirs == pytest.approx(np.sqrt(np.mean(np.abs(p - q) ** 2)), abs=2e-6)


def relative(x: np.ndarray, y: np.ndarray, theta: np.ndarray, steps: int) -> np.ndarray:
    """Return each position relative to the pose ``steps`` earlier: forward + i left, (n - steps,)."""
    z = x + 1j * y
    return (z[steps:] - z[:-steps]) * np.exp(-1j * theta[:-steps])


@pytest.mark.long
@needs_evo
@needs_shared
def test_ape_on_a_real_drive(tmp_path: Path):
    drive = clip(read_drive(DRIVES / "kitti-09-30-0033"), 0.0, 60.0)
    _, truth_file, estimate_file = written(drive, tmp_path, "tum")
    theirs = evo("evo_ape", "tum", truth_file, estimate_file, "--t_max_diff", 0.001)
    assert theirs == pytest.approx(position_rmse(drive), abs=2e-6)


@pytest.mark.long
@needs_evo
def test_kitti_poses_are_read(tmp_path: Path):
    drive = make_drive(duration=20.0)
    estimate, _, file = written(drive, tmp_path, "kitti")
    away = np.array([3.0, 4.0, 0.0, 0.0, 0.0])
    moved = replace(estimate, mean=estimate.mean + away)
    write_estimate(moved, tmp_path / "moved.kitti")
    assert evo("evo_ape", "kitti", tmp_path / "moved.kitti", file) == pytest.approx(5.0, abs=1e-6)
