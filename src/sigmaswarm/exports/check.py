"""Compile an exported C filter, run it through the exported Python module, and compare it with sigmaswarm."""

import importlib.util
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.c99 import fits_float, start_numbers
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.exports.names import LIBRARIES
from sigmaswarm.filters.bank.run import BankRun, stream
from sigmaswarm.filters.filter_run import join_chunks
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter, whole_pass
from sigmaswarm.geodesy import wrap_angle

COMPILERS = ("cc", "gcc", "clang")
OPTIMIZE = "-O2"
_SOURCES = ("ins_gps.c", "ins_gps_align.c", "ins_gps_shared.c")


@dataclass(frozen=True)
class Difference:
    """Largest differences: state, relative to max(1, |x|); position, m; heading, rad. NaN if a filter failed."""

    state: float
    position: float
    heading: float


@dataclass(frozen=True)
class ExportCheck:
    """Differences on a drive, in double and in float. ``single`` is None if the filter exceeds the range of float."""

    drive: str
    double: Difference
    single: Difference | None


def check_export(
    folder: Path,
    parameters: FilterParameters,
    drives: Sequence[Drive],
    *,
    as_recorded: bool = False,
    lanes: int = 1,
    seed: int = 0,
) -> list[ExportCheck]:
    """Compile the exported C library in ``folder``, and compare it with Python on drives.

    For the arguments see `export_texts`.

    The reference is `run_filter` without resets or, if ``lanes`` exceeds 1, a `LiveFilterBank` without searches. Raises
    `InputError` if there is no C compiler, if the build fails, or if a drive lacks data that the filter needs, and
    `AlignmentError` if a drive has no initial state.
    """
    all_lanes = Lanes(lanes, seed)
    double, single_precision = LIBRARIES
    built = [_shared_object(folder, double)]
    if all(fits_float(p) for p in all_lanes.filters(parameters)):
        built.append(_shared_object(folder, single_precision, "-DINS_GPS_FLOAT"))
    checked: list[ExportCheck] = []
    # A process loads a path only once, so a new build needs another path.
    with tempfile.TemporaryDirectory() as loaded:
        libraries = [Path(shutil.copy(library, loaded)) for library in built]
        for drive in drives:
            expected = _expected(drive, parameters, all_lanes, as_recorded=as_recorded)
            start = start_numbers(drive, parameters.model, as_recorded=as_recorded)
            runs = [_replay(folder, library, parameters, drive, start) for library in libraries]
            double, *single = (_difference(run, expected) for run in runs)
            checked.append(ExportCheck(drive.name, double, single[0] if single else None))
    return checked


def _expected(drive: Drive, parameters: FilterParameters, lanes: Lanes, *, as_recorded: bool) -> Array:
    if lanes.n == 1:
        return run_filter(drive, parameters, recover=False, as_recorded=as_recorded).mean
    replay = whole_pass(drive, as_recorded=as_recorded)
    run = BankRun(replay, parameters, seed=lanes.seed, searches=False, as_recorded=as_recorded)
    run.bank.count_only(lanes.n)
    return join_chunks(run).mean


def find_compiler() -> str | None:
    return os.environ.get("CC") or next(filter(shutil.which, COMPILERS), None)


def _shared_object(folder: Path, name: str, *flags: str) -> Path:
    compiler = find_compiler()
    if compiler is None:
        raise InputError(
            f"no C compiler was found ({', '.join(COMPILERS)}); install a compiler, or set the variable CC to one"
        )
    options = ("-std=c99", OPTIMIZE, "-shared", "-fPIC", *flags)
    command = [*compiler.split(), *options, *_SOURCES, "-lm", "-o", name]
    try:
        built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise InputError(
            f"the C compiler {compiler} does not run: {error.strerror}; set CC to another compiler"
        ) from None
    if built.returncode != 0:
        first = next(iter(built.stderr.splitlines()), f"exit code {built.returncode}")
        raise InputError(f"{compiler} could not build {folder / name}: {first}")
    return (folder / name).resolve()


def _replay(folder: Path, library: Path, p: FilterParameters, drive: Drive, start: list[float]) -> Array:
    """Return the means (k, n) that the exported Python module computes after each sample that follows the start."""
    spec = importlib.util.spec_from_file_location("ins_gps", folder / "ins_gps.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    begin, *start = start
    lever_arm = (*start[:2], start.pop(32) if MODELS[p.model].tilts else 0.0)
    exported = module.Filter(begin, start[2:7], start[7:32], lever_arm, library, start[32:])
    takes_std = p.accuracy_scale is not None or p.fix_error is not None
    means: list[list[float]] = []
    for name, time, *data in stream(drive, MODELS[p.model].imu):
        if name == "imu":
            exported.predict(time, *data)
            if time > begin:
                means.append(exported.mean)
        elif name == "fix":
            position, velocity, std, heading = data
            velocity = None if velocity is None or np.isnan(velocity[0]) else velocity
            more = {"std": std or [0.0, 0.0]} if takes_std else {}
            if p.heading_noise is not None and np.isfinite(heading[1]):
                more["heading"] = heading
            exported.update(time, position, velocity=velocity, **more)
        elif p.odometer_noise is not None:
            exported.odometer(time, *data)
    return np.array(means)


def _difference(means: Array, expected: Array) -> Difference:
    error = means - expected
    error[:, 4] = wrap_angle(error[:, 4])
    return Difference(
        float(np.max(np.abs(error) / np.maximum(1.0, np.abs(expected)))),
        float(np.max(np.hypot(error[:, 0], error[:, 1]))),
        float(np.max(np.abs(error[:, 4]))),
    )
