"""Accuracy and speed of `sigmaswarm noise`.

    python benchmarks/imu_noise.py accuracy    # one hour at 100 Hz of each grade of the simulator, 20 seeds
    python benchmarks/imu_noise.py mixtures    # white noise, flicker noise and walks of one hour, 60 seeds
    python benchmarks/imu_noise.py speed       # 24 h at 100 Hz from a Parquet file, compared with allantools

Prints Markdown. An interval is right if it contains the simulated value; the simulated white noise includes that of the
quantization. Grades of the simulator have no flicker noise, so the interval of their bias instability is right if it
begins at 0.
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from noise.test_noise import MIXTURES, covered
from sigmaswarm.noise import allan_deviation, imu_noise
from static_logs import GRADES, planted, static_log

DAY = 86_400.0
"""Duration of a day, s."""


def accuracy(seeds: int) -> None:
    """Print, for each grade, the largest error of the white noise and the fractions of right intervals."""
    print(
        "| grade | white noise, largest error | covered: white, instability, walk | walk shown | drifts reported |"
    )
    print("|---|---:|---:|---:|---:|", flush=True)
    total = list[tuple[bool, ...]]()
    for grade in GRADES:
        errors, covers, shown, drifts = list[float](), list[tuple[bool, ...]](), list[bool](), 0
        for seed in range(seeds):
            for axis in imu_noise(static_log(grade, 3600.0, seed=seed)).axes:
                known = planted(grade, axis.axis)
                errors.append(axis.white.value / known.white - 1)
                pairs = (axis.white, known.white), (axis.instability, 0.0), (axis.walk, known.walk)
                covers.append(tuple(i.low <= value <= i.high for i, value in pairs))
                shown.append(axis.walk.low > 0)
                drifts += axis.drift != 0
        share = " ".join(f"{100 * s:.1f}%" for s in np.mean(covers, axis=0))
        worst = 100 * np.max(np.abs(errors))
        print(
            f"| {grade} | {worst:.1f}% | {share} | {100 * np.mean(shown):.0f}% | {drifts} of {len(covers)} |",
            flush=True,
        )
        total += covers
    print(f"\nall: {' '.join(f'{100 * s:.1f}%' for s in np.mean(total, axis=0))}")


def mixtures(seeds: int) -> None:
    """Print the fractions of right intervals for mixtures of noises."""
    print("| noises | covered: white, instability, walk |\n|---|---:|", flush=True)
    for name in MIXTURES:
        share = np.mean(covered(name, range(seeds)), axis=0)
        print(f"| {name} | {' '.join(f'{100 * s:.0f}%' for s in share)} |", flush=True)


def speed() -> None:
    """Print time and memory for a log of a day, and the time of allantools relative to ours."""
    import allantools

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "day.parquet"
        write_day(path)
        values = pl.read_parquet(path, columns=["gz"])["gz"].to_numpy()
        first = time.perf_counter()
        tau, _ = allan_deviation([values], 0.01)
        second = time.perf_counter()
        allantools.oadev(values, rate=100.0, data_type="freq", taus=tau)
        third = time.perf_counter()
        ratio = (third - second) / (second - first)
        print(f"one axis, {len(tau)} averaging times: allantools takes {ratio:.1f} times as long")
        del values
        measured(path)


def write_day(path: Path) -> None:
    """Write a log of white noise, in single precision, since the measurement must determine the peak memory."""
    rng, count = np.random.default_rng(0), round(DAY * 100)
    columns = {"t": pl.Series(np.arange(count) * 0.01)}
    for axis in ("ax", "ay", "az", "gx", "gy", "gz"):
        columns[axis] = pl.Series(1e-3 * rng.standard_normal(count) + 9.81 * (axis == "az"))
    pl.DataFrame(columns).write_parquet(path)


def measured(path: Path) -> None:
    """Run the command in a separate process; print its time and peak memory."""
    import subprocess

    before = time.perf_counter()
    command = [sys.executable, "-m", "sigmaswarm", "noise", str(path), "--json"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - before
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = usage.ru_utime + usage.ru_stime
    print(f"24 h at 100 Hz, six axes: {seconds:.1f} s ({cpu:.1f} s of CPU), {usage.ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["accuracy", "mixtures", "speed"])
    parser.add_argument("--seeds", type=int)
    given = parser.parse_args()
    if given.what == "accuracy":
        accuracy(given.seeds or 20)
    elif given.what == "mixtures":
        mixtures(given.seeds or 60)
    else:
        speed()
