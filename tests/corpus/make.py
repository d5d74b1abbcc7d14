"""Write the corpus: small files of every kind, written by the version of sigmaswarm that runs this script.

    PYTHON_OF_THAT_VERSION tests/corpus/make.py NEW_FOLDER tests/corpus/VERSION.tar.xz

Pictures are left out. ``expected.json`` in the archive records the numbers that this version computed from its own
files; `tests/test_corpus.py` compares later versions with it.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tarfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import sigmaswarm

COMMAND = str(Path(sys.executable).parent / "sigmaswarm")
TINY = ("--particles", "4", "--generations", "3", "--workers", "1", "--trust-log")
EVERY_USE = "lateral standstill odometer accuracy robust velocity latency"
TUNINGS = {  # name: drives, options
    "default": ("town-0 town-1", ""),
    "default-no-truth": ("bare-0 bare-1", ""),
    "paper": ("town-0", "--paper"),
    "planar5": ("town-0", "--model planar5 --kind ukf"),
    "planar5-ekf": ("town-0", "--model planar5 --kind ekf"),
    "planar5-adaptive-ukf": ("town-0", "--model planar5 --kind adaptive-ukf"),
    "planar5-strong-tracking-ukf": ("town-0", "--model planar5 --kind strong-tracking-ukf"),
    "planar5-fuzzy-ukf": ("town-0", "--model planar5 --kind fuzzy-ukf"),
    "planar8": ("town-0", "--model planar8 --kind ukf --use-nothing"),
    "planar8-ekf": ("town-0", "--model planar8 --kind ekf --use gate lateral"),
    "planar8-adaptive-ukf": ("town-0", "--model planar8 --kind adaptive-ukf --use-nothing"),
    "planar8-strong-tracking-ukf": ("town-0", "--model planar8 --kind strong-tracking-ukf --use-nothing"),
    "planar8-fuzzy-ukf": ("town-0", "--model planar8 --kind fuzzy-ukf --use-nothing"),
    "planar8-no-truth": ("bare-0", "--model planar8"),
    "planar8-everything": ("stated-0", f"--model planar8 --use {EVERY_USE}"),
    "tilted12": ("town-0", "--model tilted12"),
    "tilted12-no-truth": ("bare-0", "--model tilted12"),
    "tilted12-everything": ("stated-0", f"--model tilted12 --use {EVERY_USE}"),
    "world": ("world-0", ""),
    "world-no-truth": ("world-bare-0", ""),
    "outage-rmse": ("bare-0", "--model planar5 --objective outage-rmse"),
    "prior": ("bare-0", "--model planar8 --objective innovation-nll --prior 0.5"),
    "as-recorded": ("town-0", "--model planar5 --as-recorded"),
    "worst-validation-margin": (
        "town-0 town-1",
        "--worst 0.5 --validation drives/town-2 --margin 0.05 --trials 2",
    ),
} | {
    f"optimizer-{name}": ("town-0", f"--model planar5 --optimizer {name}")
    for name in ("pso", "ga", "ga-pso", "cma-es", "bo", "nelder-mead", "random", "sobol")
}


def run(*words: str) -> str:
    """Run a command of this version in the current folder; return what it prints."""
    done = subprocess.run([COMMAND, *words], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}:\n{done.stdout}{done.stderr}")
    return done.stdout


def thinned(table: Any, every: int, digits: int = 5, **changes: Any) -> Any:
    """Return every n-th row of a table, rounded, since full precision would make the archive large."""
    kept: dict[str, Any] = {}
    for field in fields(table):
        values = getattr(table, field.name)
        exact = field.name in ("time", "lat", "lon")
        kept[field.name] = (
            None if values is None else (values[::every] if exact else np.round(values[::every], digits))
        )
    return type(table)(**kept | changes)


def town(run_number: int, name: str, *, duration: float = 30.0) -> sigmaswarm.Drive:
    """Simulate a drive at 50 Hz with six axes, truth at 10 Hz and an odometer."""
    whole = sigmaswarm.simulate(
        "urban", run=run_number, duration=duration, gps="white-1m", vibration=True, odometer="pulses"
    )
    assert whole.truth is not None and whole.odometer is not None
    return replace(
        whole,
        name=name,
        imu=thinned(whole.imu, 2),
        gps=thinned(whole.gps, 1),
        truth=thinned(whole.truth, 10),
        odometer=thinned(whole.odometer, 2),
    )


def stated(drive: sigmaswarm.Drive, name: str) -> sigmaswarm.Drive:
    """Add the receiver's stated standard deviations, speed and course to a drive."""
    truth = drive.truth
    assert truth is not None
    rng = np.random.default_rng(7)
    t = drive.gps.time
    speed = np.abs(np.interp(t, truth.time, np.hypot(truth.vx, truth.vy)) + 0.1 * rng.standard_normal(len(t)))
    course = np.interp(t, truth.time, np.unwrap(truth.theta)) + 0.02 * rng.standard_normal(len(t))
    gps = replace(
        drive.gps,
        std_x=np.full(len(t), 1.0),
        std_y=np.round(rng.uniform(0.8, 1.5, len(t)), 2),
        speed=np.round(speed, 3),
        course=np.round((course + np.pi) % (2 * np.pi) - np.pi, 4),
    )
    return replace(drive, name=name, gps=gps)


def world(drive: sigmaswarm.Drive, name: str) -> sigmaswarm.Drive:
    """Convert a drive to latitude and longitude, with heights."""
    from sigmaswarm.geodesy import enu_to_geodetic

    origin = (49.0, 8.4, 110.0)
    local = np.column_stack([drive.gps.x, drive.gps.y, np.zeros_like(drive.gps.x)])
    lat, lon, alt = np.round(enu_to_geodetic(local, origin), 9).T
    gps = replace(drive.gps, lat=lat, lon=lon, alt=alt)
    return replace(drive, name=name, frame="wgs84", origin=origin, gps=gps)


def write_drives() -> None:
    """Write drives of each frame, with and without truth, odometer and stated standard deviations; CSV and Parquet."""
    drives = [town(i, f"town-{i}") for i in range(3)]
    drives += [replace(town(i + 3, f"bare-{i}"), truth=None, odometer=None) for i in range(2)]
    drives += [stated(town(5, "town-5"), "stated-0"), world(town(6, "town-6"), "world-0")]
    drives.append(replace(world(town(7, "town-7"), "world-bare-0"), truth=None, odometer=None))
    flat = town(8, "three-axes")
    drives.append(replace(flat, imu=replace(flat.imu, az=None, gx=None, gy=None), odometer=None))
    drives.append(town(9, "long", duration=60.0))
    for drive in drives:
        sigmaswarm.write_drive(drive, Path("drives") / drive.name)
    run("convert", "drives/town-2", "drives/world-0", "parquet")


def write_tunings() -> None:
    """Write a tuning for each model, filter type, optimizer and kind of objective."""
    for name, (drives, options) in TUNINGS.items():
        budget = ("--workers", "1") if name == "paper" else TINY  # the paper's setting has a fixed budget
        run(
            "tune",
            *(f"drives/{d}" for d in drives.split()),
            "--out",
            f"tunings/{name}",
            *budget,
            *options.split(),
        )


class Stopped(Exception):
    """Stands for the end of the process."""


def write_interrupted() -> None:
    """Write a tuning with a checkpoint in its second trial, and the finished tuning."""
    drives = [sigmaswarm.read_drive("drives/town-0"), sigmaswarm.read_drive("drives/town-1")]
    for optimizer in ("de", "pso", "cma-es"):
        options: dict[str, Any] = {"model": "planar5", "objective": "truth-rmse", "particles": 4}
        options |= {"generations": 6, "trials": 2, "seed": 3, "optimizer": optimizer}

        def stop(progress: Any) -> None:
            if progress.done >= 9:
                raise Stopped

        with suppress(Stopped):
            sigmaswarm.tune(drives, out=f"interrupted/{optimizer}", progress=stop, **options)
        assert list(Path(f"interrupted/{optimizer}").glob("checkpoint-*.npz")), optimizer
        sigmaswarm.tune(drives, out=f"uninterrupted/{optimizer}", **options)


def custom_model() -> tuple[sigmaswarm.Model, list[sigmaswarm.Log]]:
    """Return a user's model (a position with a measured speed as input) and two logs."""

    def f(state: Any, dt: float, u: Any, p: Any) -> Any:
        return np.array([state[0] + (u[0] - state[1]) * dt, state[1]])

    def h(state: Any, p: Any) -> Any:
        return state[:1]

    def process_noise(dt: float, p: Any) -> Any:
        return np.array([p.q, 1e-8]) * dt

    def measurement_noise(p: Any) -> Any:
        return np.array([p.r])

    model = sigmaswarm.Model(
        name="track",
        states=("position", "bias"),
        f=f,
        h=h,
        parameters=(
            sigmaswarm.Tunable("q", 1e-6, 1.0, unit="m2/s"),
            sigmaswarm.Tunable("r", 1e-3, 10.0, unit="m2"),
        ),
        process_noise=process_noise,
        measurement_noise=measurement_noise,
        scored=("position",),
    )
    logs: list[sigmaswarm.Log] = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        time = np.arange(401) / 20
        position = 5 * np.sin(time / 3)
        speed = 5 / 3 * np.cos(time / 3) + 0.2 + 0.05 * rng.standard_normal(len(time))
        logs.append(
            sigmaswarm.Log(
                name=f"log-{seed}",
                time=time,
                inputs=speed,
                measurement_time=time[10::10],
                measurements=position[10::10] + 0.3 * rng.standard_normal(40),
                mean=[0, 0],
                covariance=np.diag([1.0, 0.1]),
                truth={"position": position},
            )
        )
    return model, logs


def write_custom() -> None:
    """Write a tuning of a user's model."""
    model, logs = custom_model()
    sigmaswarm.tune(
        logs, model=model, objective="innovation-nll", particles=4, generations=3, out="custom/track"
    )


def write_filter() -> None:
    """Write a file that contains only the parameters of a filter."""
    Path("filters").mkdir()
    sigmaswarm.datasheet(sigmaswarm.read_drive("drives/town-0")).save("filters/own.toml")


def write_evaluations() -> None:
    """Write evaluations: with truth, without truth, against another tuning, smoothed, and with a filter bank."""
    for name, words in {
        "plain": ("tunings/default", "drives/town-2"),
        "two-drives": ("tunings/planar5", "drives/town-1", "drives/town-2"),
        "no-truth": ("tunings/default-no-truth", "drives/bare-1"),
        "against": ("tunings/planar8", "drives/town-2", "--against", "tunings/planar5-ekf"),
        "against-file": ("tunings/planar8", "drives/town-2", "--against", "filters/own.toml"),
        "smooth": ("tunings/planar8-ekf", "drives/town-2", "--smooth"),
        "swarm": ("tunings/planar5", "drives/town-2", "--swarm"),
        "world": ("tunings/world", "drives/world-0"),
        "world-no-truth": ("tunings/world-no-truth", "drives/world-bare-0"),
    }.items():
        run("evaluate", *words, "--out", f"evaluations/{name}", "--trust-log")


def write_recipes() -> None:
    """Write logs with unusual columns, recipes for these logs, and the imported drives."""
    drive = sigmaswarm.read_drive("drives/three-axes")
    Path("logs").mkdir()
    rows = zip(drive.imu.time, drive.imu.ax, drive.imu.ay, np.degrees(drive.imu.gz), strict=True)
    lines = [
        "stamp,forward,right,yaw_rate",
        *(f"{t * 1e3:.3f},{a:.5f},{-b:.5f},{c:.5f}" for t, a, b, c in rows),
    ]
    Path("logs/imu.csv").write_text("\n".join(lines) + "\n")
    world_drive = sigmaswarm.read_drive("drives/world-0")
    lat, lon = world_drive.gps.lat, world_drive.gps.lon
    assert lat is not None and lon is not None
    fixes = zip(world_drive.gps.time, lat, lon, strict=True)
    lines = ["seconds,latitude,longitude", *(f"{t:.3f},{a * 1e7:.0f},{b * 1e7:.0f}" for t, a, b in fixes)]
    Path("logs/gps.csv").write_text("\n".join(lines) + "\n")
    maps = (
        "ax=forward",
        "ay=-right",
        "gz=radians(yaw_rate)",
        "gps.t=seconds",
        "lat=latitude*1e-7",
        "lon=longitude*1e-7",
    )
    words = ("logs/imu.csv", "--gps", "logs/gps.csv", "--time", "stamp*1e-3", "--map", *maps)
    run("import", *words, "--out", "imported/csv", "--save-recipe", "recipes/csv.toml")
    mounted = ("--mount", "90", "--gps-offset", "-0.05", "--origin", "49,8.4,110")
    run("import", *words, *mounted, "--out", "imported/mounted", "--save-recipe", "recipes/mounted.toml")


def write_comparison_and_study() -> None:
    """Write a comparison of two optimizers and a study of two trials, both with drives of the corpus."""
    drives = tuple(f"drives/town-{i}" for i in range(3))
    run(
        *("compare", *drives[:2], "--validation", drives[2], "--optimizers", "pso", "de", "pso:polish=2"),
        *("--model", "planar5", "--particles", "3", "--generations", "2", "--trials", "2", "--workers", "1"),
        *("--out", "comparison"),
    )
    tiny = ("--trials", "2", "--particles", "2", "--generations", "1", "--workers", "1")
    run("study", "--drives", *drives, "--out", "study", *tiny)


def write_learned() -> None:
    """Write both networks and a filter of planar8."""
    for network in ("outage-lstm", "noise-gru"):
        run(
            "learn", network, "tunings/planar8", "drives/long", "drives/town-1", "--out", f"learned/{network}"
        )


def write_others() -> None:
    """Write a reference, exports with replays, estimates, and the filter on which a bank has settled."""
    run("reference", "drives/town-2", "--fixes", "drives/town-2", "--out", "reference", "--accuracy", "3")
    for target in ("filterpy", "c99", "robot_localization"):
        more = ("--replay", "drives/town-2") if target == "c99" else ()
        run("export", "tunings/planar5", "--to", target, "--out", f"exports/{target}", *more)
    Path("estimates").mkdir()
    run("run", "tunings/planar5", "drives/town-2", "--out", "estimates/swarm.csv", "--swarm")
    Path("estimates/swarm.csv").unlink()  # large; the settled filter is kept
    run("run", "tunings/planar8", "drives/town-2", "--out", "estimates/plain.csv")


def drive_of(name: str) -> str:
    """Return the drive over which a tuning is run for `expected.json`."""
    if name.startswith("world"):
        return "world-0"
    return "stated-0" if name.endswith("everything") else "town-2"


def write_expected() -> None:
    """Record values that this version computes from the files: scores, estimates, findings, drives as read."""
    import numba
    import scipy

    made_with = {"python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__}
    made_with |= {"scipy": scipy.__version__, "machine": platform.machine()}
    found: dict[str, Any] = {"made_with": made_with, "tunings": {}, "drives": {}, "learned": {}}
    for name in TUNINGS:
        drive = sigmaswarm.read_drive(f"drives/{drive_of(name)}")
        parameters = sigmaswarm.FilterParameters.load(f"tunings/{name}")
        score = sigmaswarm.evaluate(drive, parameters).scores[drive.name]["tuned"]
        estimate = sigmaswarm.run_filter(drive, parameters)
        found["tunings"][name] = {
            "drive": drive.name,
            "score": asdict(score),
            "last_mean": estimate.mean[-1].tolist(),
            "sum_of_means": estimate.mean.sum(axis=0).tolist(),
            "last_variances": np.diag(estimate.covariance[-1]).tolist(),
        }
    for folder in sorted(
        [*Path("drives").iterdir(), *Path("parquet").iterdir(), *Path("imported").iterdir()]
    ):
        drive = sigmaswarm.read_drive(folder)
        tables = {"imu": drive.imu, "gps": drive.gps, "truth": drive.truth, "odometer": drive.odometer}
        found["drives"][str(folder)] = {
            "frame": drive.frame,
            "sums": {
                f"{role}.{field.name}": float(getattr(table, field.name).sum())
                for role, table in tables.items()
                if table is not None
                for field in fields(table)
                if getattr(table, field.name) is not None
            },
            "findings": sorted(finding.code for finding in sigmaswarm.diagnose(drive).findings),
        }
    for network in ("outage-lstm", "noise-gru"):
        if Path(f"learned/{network}").exists():
            lines = run("evaluate", f"learned/{network}", "drives/town-2", "--json", "--trust-log")
            found["learned"][network] = json.loads(lines)["mean"]
    Path("expected.json").write_text(json.dumps(found, indent=1))


STEPS: dict[str, Callable[[], None]] = {
    "drives": write_drives,
    "filters": write_filter,
    "tunings": write_tunings,
    "interrupted": write_interrupted,
    "custom": write_custom,
    "evaluations": write_evaluations,
    "recipes": write_recipes,
    "comparison": write_comparison_and_study,
    "learned": write_learned,
    "others": write_others,
    "expected": write_expected,
}


def pack(folder: Path, archive: Path) -> None:
    """Pack all files except pictures and pages; equal files give an equal archive."""

    def plain(member: tarfile.TarInfo) -> tarfile.TarInfo | None:
        if Path(member.name).suffix in (".png", ".svg", ".html", ".pdf"):
            return None
        member.uid = member.gid = 0
        member.uname = member.gname = ""
        member.mtime = 0
        return member

    with tarfile.open(archive, "w:xz", preset=9) as packed:
        for item in sorted(folder.iterdir()):
            packed.add(item, item.name, filter=plain)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("archive", type=Path)
    parser.add_argument(
        "--only", nargs="*", choices=STEPS, help="do these steps alone, in a folder that is there"
    )
    asked = parser.parse_args()
    archive = asked.archive.resolve()
    asked.folder.mkdir(exist_ok=True)
    os.chdir(asked.folder)
    for name, step in STEPS.items():
        if asked.only is None or name in asked.only:
            print(name, flush=True)
            step()
    pack(Path(), archive)
    print(f"{archive.stat().st_size / 1e6:.2f} MB, sha256 {hashlib.sha256(archive.read_bytes()).hexdigest()}")


if __name__ == "__main__":
    main()
