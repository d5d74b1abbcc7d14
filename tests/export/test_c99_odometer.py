"""Exported filters with an odometer: C and the script equal the run, also with late readings."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exported import SANITIZERS, build, distance, needs_gcc, replay, run_script
from filter_cases import OPTIONS, equipped, parameters
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from stepwise import urban, wheeled
from support import quickly

WHEELS = {"odometer_noise": 0.01, "odometer_scale": 1.02, "odometer_latency": 0.04}


def given(model: str, kind: str, **more: object) -> FilterParameters:
    return parameters(model, kind=kind, nominal_interval=0.01, **WHEELS, **more)


@needs_gcc
@pytest.mark.parametrize("option", quickly([("plain",), ("all",)], lambda option: option == "all"))
@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(
        [("planar5", "ukf"), ("planar8", "ukf"), ("planar8", "ekf"), ("tilted12", "ekf")],
        lambda model, kind: (model, kind) == ("planar8", "ekf"),
    ),
)
def test_it_equals_the_run(tmp_path: Path, model: ModelName, kind: str, option: str):
    p, drive = given(model, kind, **OPTIONS[option]), wheeled(equipped())
    ours = run_filter(drive, p, recover=False)
    theirs = replay(build(tmp_path, p, *SANITIZERS), drive, model)
    assert distance(theirs.mean, ours.mean) < 1e-10
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-8)
    without = run_filter(drive, replace(p, odometer_noise=None), recover=False)
    assert distance(without.mean, ours.mean) > 1e-3


@pytest.mark.long
@needs_gcc
def test_standstills_are_those_of_the_run(tmp_path: Path):
    p, drive = given("planar8", "ukf", standstill_noise=1e-3), wheeled(urban())
    assert distance(replay(build(tmp_path, p), drive).mean, run_filter(drive, p, recover=False).mean) < 1e-9


def rows_late(drive: Drive, late: float) -> str:
    """Return the rows of a replay, where each odometer reading arrives ``late`` s after its time."""
    start, *rows = replay_rows(drive).splitlines()
    key = [float(row.split(",")[1]) + (late if row.startswith("odometer") else 0.0) for row in rows]
    return "\n".join([start, *(rows[i] for i in np.argsort(key, kind="stable"))]) + "\n"


@needs_gcc
def test_late_readings_are_applied_at_their_time(tmp_path: Path):
    p, drive = given("planar8", "ukf"), wheeled(equipped())
    program, late = build(tmp_path, p, "-DINS_GPS_READINGS=200"), 0.35
    done = subprocess.run([program], input=rows_late(drive, late), capture_output=True, text=True, check=True)
    last = np.array([float(cell) for cell in done.stdout.splitlines()[-1].split(",")])[1:9]
    assert drive.odometer is not None
    known = drive.odometer.select(drive.odometer.time + late <= drive.imu.time[-1])
    ours = run_filter(replace(drive, odometer=known), p, recover=False)
    np.testing.assert_allclose(last, ours.mean[-1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", quickly([("ukf",), ("ekf",)], lambda kind: kind == "ekf"))
def test_the_script_equals_the_run(tmp_path: Path, kind: str):
    p, drive = given("planar8", kind, **OPTIONS["all"]), clip(wheeled(equipped()), 0.0, 9.0)
    ours = run_filter(drive, p, recover=False).mean
    assert distance(run_script(tmp_path, p, drive).mean, ours) < 1e-10
    without = run_filter(drive, replace(p, odometer_noise=None), recover=False).mean
    assert distance(without, ours) > 1e-3
