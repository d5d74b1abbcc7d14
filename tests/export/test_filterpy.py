"""The exported FilterPy script gives the library's numbers, without the library."""

import ast
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from exported import distance, jumping, run_alone, run_script, tuned, twin
from filter_cases import KINDS, OPTIONS, WEIGHED, WEIGHED_CASES, equipped, parameters, rough, straying
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.exports.filterpy import filterpy, source_of
from sigmaswarm.filters.run import run_filter
from sigmaswarm.geodesy import enu_to_geodetic
from support import DRIVES, make_drive, needs_shared, quickly

REAL = {
    "kitti-09-30-0033": ("ukf", 0.0, 20.0),
    "colorado-1": ("ekf", 40.0, 65.0),
    "dresden": ("adaptive-ukf", 0.0, 30.0),  # frame in degrees, with speed and course
    "kingston-1": ("ukf", 560.0, 700.0),  # with a standstill
}
ORIGIN = (49.011, 8.416, 110.0)


QUICK = [("planar8", "ukf"), ("planar8", "strong-tracking-ukf"), ("planar5", "adaptive-ukf")]


@pytest.mark.parametrize(
    ("model", "kind"), quickly(product(("planar5", "planar8"), KINDS), lambda *case: case in QUICK)
)
def test_it_equals_the_run(tmp_path: Path, model: str, kind: str):
    drive = clip(equipped(), 0.0, 9.0)
    p = parameters(model, kind=kind, nominal_interval=0.01, **OPTIONS["all"])
    ours = run_filter(drive, p, recover=False)
    theirs = run_script(tmp_path, p, drive)
    np.testing.assert_array_equal(theirs.time, ours.time)
    assert distance(theirs.mean, ours.mean) < 1e-10
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "option"),
    quickly(WEIGHED_CASES, lambda *case: case == ("ekf", "both")),
)
def test_it_weights_fixes_as_the_run_does(tmp_path: Path, kind: str, option: str):
    p = parameters("planar8", kind=kind, nominal_interval=0.01, **WEIGHED[option])
    ours, theirs = run_filter(straying(), p), run_script(tmp_path, p, straying())
    assert distance(theirs.mean, ours.mean) < 1e-10
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-9)


@pytest.mark.parametrize("kind", quickly([("ukf",), ("ekf",)], lambda kind: kind == "ekf"))
def test_stale_fixes_and_gaps_are_treated_as_in_the_run(tmp_path: Path, kind: str):
    drive = clip(rough(), 4.0, 14.0)
    ready = PreparedDrive(drive)
    assert ready.stale.sum() == 5
    assert ready.timeline().gap.any()
    p = parameters("planar8", kind=kind, nominal_interval=0.01, **OPTIONS["all"])
    assert distance(run_script(tmp_path, p, drive).mean, run_filter(ready, p).mean) < 1e-10


def test_a_filter_tuned_without_preprocessing_runs_without_it(tmp_path: Path):
    drive = clip(rough(), 4.0, 14.0)
    p = parameters("planar5", nominal_interval=0.01)
    theirs = run_script(tmp_path, p, drive, as_recorded=True).mean
    assert distance(theirs, run_filter(drive, p, as_recorded=True).mean) < 1e-10


def test_the_gate_accepts_a_jump_as_in_the_run(tmp_path: Path):
    p, drive = (
        parameters("planar5", kind="ekf", nominal_interval=0.01, gate=6.0),
        jumping(clip(equipped(), 0.0, 14.0)),
    )
    assert distance(run_script(tmp_path, p, drive).mean, run_filter(drive, p, recover=False).mean) < 1e-10


@needs_shared
@pytest.mark.parametrize("name", quickly([(name,) for name in REAL], lambda name: name == "colorado-1"))
def test_it_equals_the_run_on_real_drives(tmp_path: Path, name: str):
    kind, start, end = REAL[name]
    drive = clip(read_drive(DRIVES / name), start, end)
    p = tuned("planar8", kind, drive.nominal_interval)
    ours, of_twin = twin(drive, p)
    assert of_twin < 1e-12
    assert distance(run_script(tmp_path, p, drive).mean, ours) < 1e-9


def in_degrees(drive: Drive) -> Drive:
    enu = np.column_stack([drive.gps.x, drive.gps.y, np.zeros(len(drive.gps))])
    lat, lon, alt = enu_to_geodetic(enu, ORIGIN).T
    return replace(drive, frame="wgs84", origin=ORIGIN, gps=replace(drive.gps, lat=lat, lon=lon, alt=alt))


def test_it_reads_degrees(tmp_path: Path):
    drive = in_degrees(make_drive(duration=8.0))
    p = tuned("planar5", "ukf", 0.01, everything=False)
    folder = write_drive(drive, tmp_path / "degrees")
    ours = run_filter(read_drive(folder), p, recover=False)
    assert distance(run_script(tmp_path, p, folder).mean, ours.mean) < 1e-10


def test_a_drive_without_a_start_causes_one_line(tmp_path: Path):
    drive = make_drive(duration=8.0)
    still = replace(drive, gps=replace(drive.gps, x=0 * drive.gps.x, y=0 * drive.gps.y))
    folder = write_drive(still, tmp_path / "still")
    (tmp_path / "s.py").write_text(filterpy(tuned("planar5", "ukf", 0.01), 0.01)["run_filter.py"])
    done = run_alone(tmp_path / "s.py", folder, tmp_path / "e.csv")
    assert done.returncode == 2
    assert (
        done.stderr.startswith("synthetic: the vehicle never travels 20 m") and done.stderr.count("\n") == 1
    )
    done = run_alone(tmp_path / "s.py", folder)
    assert done.stderr == "usage: python run_filter.py DRIVE estimate.csv\n"


def test_without_filterpy_it_names_what_to_install(tmp_path: Path):
    (tmp_path / "s.py").write_text(filterpy(tuned("planar5", "ukf", 0.01), 0.01)["run_filter.py"])
    (tmp_path / "filterpy.py").write_text("raise ModuleNotFoundError(\"No module named 'filterpy'\")")
    command = [sys.executable, tmp_path / "s.py", "drive", tmp_path / "e.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == (
        "run_filter.py: No module named 'filterpy'; it needs Python 3.11 or newer, and: "
        "pip install numpy filterpy==2.0.0\n"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_it_imports_only_numpy_and_filterpy(kind: str):
    text = filterpy(tuned("planar8", kind, 0.01, everything=True), 0.01)["run_filter.py"]
    imported = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(str(node.module).split(".")[0])
    others = imported - set(sys.stdlib_module_names)
    assert others == {"numpy", "filterpy"}


def test_names_of_the_joined_modules_are_unique():
    text = filterpy(tuned("planar8", "ukf", 0.01), 0.01)["run_filter.py"]
    names: list[str] = []
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign):
            names += [n.id for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)]
    assert [name for name, n in Counter(names).items() if n > 1] == []


def test_sources_are_copied_without_compilation_and_imports():
    from sigmaswarm import geodesy
    from sigmaswarm.drives import gaps, standstill

    text = source_of(geodesy, ["wrap_angle"])
    assert text.startswith("def wrap_angle")
    assert text.count("def wrap_angle") == 1 and "overload" not in text and "Origin" not in text
    assert source_of(gaps, ["MANY"]).startswith("MANY = 5.0")
    assert "njit" not in source_of(standstill) and "import" not in source_of(standstill)
