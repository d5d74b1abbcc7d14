"""Build and run exported filters as users do: with a C compiler, and with a separate Python process."""

import shutil
import subprocess
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import processes
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.exports.targets import export_texts, write_texts
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
needs_clang = pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not installed")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
OPTIMIZED = ("-O2",)
"""Flags of a user's build; with optimization, the compiler finds more to warn of."""
SANITIZERS = (
    "-O0",  # optimization takes 80% of the build time, and removes faults that the sanitizers would find
    "-fsanitize=address,undefined,float-divide-by-zero,float-cast-overflow",
    "-fsanitize-undefined-trap-on-error",  # compiles 33% faster; for a report with the line, remove it and add -g
)
NO_TRAP = ("-fno-sanitize=float-divide-by-zero",)  # division by zero gives inf, which all_finite detects


_KEPT = TemporaryDirectory(prefix="sigmaswarm-built-")
"""Programs that this process has built; removed when the process ends."""


@dataclass(frozen=True)
class Replayed:
    """Output of an exported filter: times (k,), means (k, n), variances (k, n)."""

    time: np.ndarray
    mean: np.ndarray
    variance: np.ndarray


export = cache(export_texts)
"""Texts of exported filters, cached per process."""


def export_filter(parameters: FilterParameters, target: str, folder: Path, **options) -> list[Path]:
    """Write the files of a filter, with options as in `export_texts`; return their paths."""
    return write_texts(export_texts(parameters, target, **options), folder, target)


def write(folder: Path, parameters: FilterParameters, **options: int) -> None:
    """Write an exported C library."""
    write_texts(export(parameters, "c99", **options), folder, "c99")


def build(
    folder: Path,
    parameters: FilterParameters,
    *flags: str,
    compiler: str = "gcc",
    main: str = "",
    lanes: int = 1,
) -> Path:
    """Build the replay program (or ``main``, other C source) with an exported C library.

    The build is not optimized, which takes a third of the time, unless the flags contain OPTIMIZED.
    """
    write(folder, parameters, lanes=lanes)
    source = folder / "replay.c"
    if main:
        source = folder / "main.c"
        source.write_text(main)
    sources = [folder / "ins_gps.c", folder / "ins_gps_align.c", source]
    texts = tuple(file.read_text() for file in (*sources, *sorted(folder.glob("*.h"))))
    program = Path(_KEPT.name) / sha256(repr((texts, flags, compiler)).encode()).hexdigest()
    if not program.exists():  # built once for equal texts, flags and compiler
        command = [compiler, *STRICT, "-O0", *flags, *sources, "-lm", "-o", program]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        assert built.returncode == 0, built.stderr
    return Path(shutil.copy(program, folder / "program"))


def replay(program: Path, drive: Drive, model: ModelName = "planar5") -> Replayed:
    """Run the C program over a drive; planar models all use the same input rows."""
    rows = replay_rows(drive, model)
    done = subprocess.run([program], input=rows, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = np.loadtxt(done.stdout.splitlines(), delimiter=",", skiprows=1)
    n = (rows.shape[1] - 1) // 2
    return Replayed(rows[:, 0], rows[:, 1 : n + 1], rows[:, n + 1 :] ** 2)


def run_script(
    folder: Path, parameters: FilterParameters, drive: Drive | Path, *, as_recorded: bool = False
) -> Replayed:
    """Run the FilterPy script over a drive."""
    (script,) = export_filter(parameters, "filterpy", folder, as_recorded=as_recorded)
    if isinstance(drive, Drive):
        drive = write_drive(drive, folder / "drive")
    done = run_alone(script, drive, folder / "estimate.csv")
    assert done.returncode == 0, done.stderr
    rows = np.loadtxt(folder / "estimate.csv", delimiter=",", skiprows=1)
    n = (rows.shape[1] - 1) // 2
    return Replayed(rows[:, 0], rows[:, 1 : n + 1], rows[:, n + 1 :] ** 2)


def run_alone(script: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run an exported script in a process that has imported NumPy and FilterPy but cannot import sigmaswarm."""
    return processes.run(_ISOLATED, script, *arguments)


_ISOLATED = """
import runpy, sys
sys.modules["sigmaswarm"] = sys.modules["scipy.io"] = None  # so that importing them fails
sys.argv[:1] = []
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def twin(drive: Drive, parameters: FilterParameters, moved: float = 1e-13) -> tuple[np.ndarray, float]:
    """Return the library's means (k, n), and their change if the initial heading is changed by ``moved`` rad."""
    initial = initial_state(drive)
    mean = initial.mean.copy()
    mean[4] += moved
    ours = run_filter(drive, parameters, initial=initial, recover=False)
    assert ours.failure is None
    other = run_filter(drive, parameters, initial=replace(initial, mean=mean), recover=False)
    return ours.mean, distance(other.mean, ours.mean)


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference of two runs' means, relative to max(1, |x_i|), with wrapped headings."""
    difference = one - other
    difference[:, 4] = (difference[:, 4] + np.pi) % (2 * np.pi) - np.pi
    return float(np.max(np.abs(difference) / np.maximum(1.0, np.abs(other))))


def tuned(model: str, kind: str, interval: float, *, everything: bool = True) -> FilterParameters:
    """Return parameters for fixes with an error of about 1 m, similar to tuning results on real drives."""
    per_second = (1e-3, 1e-3, 0.05, 0.05, 1e-5, 1e-5, 1e-5, 1e-9, 1e-5, 1e-5, 1e-9, 1e-9)
    q = tuple(variance * interval for variance in per_second[: len(MODELS[model].states)])
    p = FilterParameters(0.5, 2.0, 0.0, q, (1.0, 1.2), model, kind=kind, nominal_interval=interval)
    if not everything:
        return p
    return replace(
        p,
        lateral_noise=0.05,
        rear_axle=0.8,
        tire_slip=0.004,
        standstill_noise=1e-3,
        gate=9.2,
        velocity_noise=0.25,
    )


def jumping(drive: Drive) -> Drive:
    """Return the drive with fixes that jump by 40 m at half time: a gate first rejects them and later accepts them."""
    late = drive.gps.time > drive.imu.time[0] + drive.duration / 2
    return replace(drive, gps=replace(drive.gps, x=drive.gps.x + 40.0 * late))
