"""Measure tuning on a Dask cluster: a scheduler and workers in separate processes on 127.0.0.1.

    python benchmarks/fleet.py PART... --folder FOLDER

    form       size and reading time of a drive in CSV and in Parquet (--drive)
    same       compare all files that tune, evaluate, study and compare write on four workers and on threads
    faults     five workers are killed at random times in a tuning and in a study, and replaced; the scheduler is killed
    scaling    one worker compared with two, each with one thread, on 16 drives of 30 minutes
    overhead   time of a generation in addition to that of the filters, by number of drives
    memory     peak of the client with 16 and 160 drives; memory of a worker per hour of driving
    thousand   1000 drives of one minute on the command line, and all warnings in the logs

Simulated drives are saved in FOLDER. Since other jobs on the machine increase the times, the load is printed.
"""

import argparse
import os
import random
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from asked_of_workers import costs, forget, nothing, timed
from dask_processes import Processes
from sigmaswarm import read_drive, simulate, tune, write_drive
from sigmaswarm.datasets.cluster import Cluster, connected
from sigmaswarm.datasets.remote import RemoteDataset, remote_datasets
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.problem import car_problem

os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # for workers: `asked_of_workers`
PROGRAM = "from sigmaswarm.cli import main; main()"
EVERY_OPTION = ("velocity", "lateral", "standstill", "odometer", "gate", "latency", "accuracy")
NOT_THE_SAME = {"timings.json", "times.csv", "runtime.csv", "runtime.md", "runtime.tex"}
"""Files that contain times."""


DIFFERENT = 16
"""Number of simulated drives of each length."""


def drives_of(folder: Path, count: int, seconds: float) -> list[Path]:
    """Return ``count`` simulated drives of a length in Parquet; beyond the first `DIFFERENT`, drives are repeated."""
    place, made = folder / f"drives-{seconds:g}s", list[Path]()
    for run in range(count):
        target = place / f"urban-clear-{run:04d}"
        if not target.exists() and run < DIFFERENT:
            drive = simulate("urban", run=run, duration=seconds, odometer="can")
            write_drive(drive, target, form="parquet")
        elif not target.exists():
            target.symlink_to(made[run % DIFFERENT])
        made.append(target)
    return made


def remote(client: Any, drives: Sequence[Path]) -> RemoteDataset:
    return remote_datasets(Cluster(client), [drives])[0][0]


def command(*arguments: object) -> tuple[int, str, str, float]:
    """Run the command line in a separate process; return exit code, output, errors, and duration, s."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)], capture_output=True, text=True
    )
    return done.returncode, done.stdout, done.stderr, time.perf_counter() - began


def tree(folder: Path) -> dict[str, bytes]:
    found = (f for f in sorted(folder.rglob("*")) if f.is_file() and f.name not in NOT_THE_SAME)
    return {str(f.relative_to(folder)): f.read_bytes() for f in found}


def compared(what: str, one: Path, other: Path) -> None:
    a, b = tree(one), tree(other)
    differing = [name for name in a.keys() | b.keys() if a.get(name) != b.get(name)]
    print(f"{what}: {len(a)} files, {len(differing)} differ {differing[:4] or ''}", flush=True)


def form(folder: Path, drive: Path) -> None:
    warnings.simplefilter("ignore")
    compact = folder / "compact"
    write_drive(read_drive(drive), compact, form="parquet", overwrite=True)
    for _ in range(2):
        for place in (drive, compact):
            began = time.perf_counter()
            read_drive(place)
            took, size = time.perf_counter() - began, sum(f.stat().st_size for f in place.iterdir())
            print(f"{place.name}: {size / 1e6:.1f} MB, read in {took:.2f} s")


def same(folder: Path) -> None:
    drives, out = drives_of(folder, 6, 60.0)[0].parent, folder / f"same-{os.getpid()}"
    search = ("--particles", 8, "--generations", 6, "--seeds", 3)
    with Processes(folder / f"dask-{os.getpid()}", 4) as running:
        at = ("--cluster", running.address)
        wanted: dict[str, tuple[Any, ...]] = {
            "tune": ("tune", drives, "--particles", 12, "--generations", 8, "--racing"),
            "evaluate": ("evaluate", out / "tune-threads", drives),
            "compare": ("compare", drives, "--optimizers", "de", "pso", "--model", "planar8", *search),
            "study": ("study", "--drives", drives, "--trials", 3, "--particles", 6, "--generations", 4),
        }
        for name, arguments in wanted.items():
            took = list[float]()
            for where, more in (("threads", ()), ("cluster", at)):
                code, _, said, seconds = command(*arguments, "--out", out / f"{name}-{where}", *more)
                assert code == 0, said
                took.append(seconds)
            compared(f"{name} ({took[0]:.0f} s on threads, {took[1]:.0f} s on four workers)",
                     out / f"{name}-threads", out / f"{name}-cluster")  # fmt: skip


def faults(folder: Path) -> None:
    drives, out = drives_of(folder, 6, 60.0)[0].parent, folder / f"faults-{os.getpid()}"
    wanted = {
        "tune": ("tune", drives, "--particles", 24, "--generations", 60, "--model", "planar8"),
        "study": ("study", "--drives", drives, "--trials", 4, "--particles", 8, "--generations", 10),
    }
    chance = random.Random(22)
    for name, arguments in wanted.items():
        code, _, said, seconds = command(*arguments, "--out", out / f"{name}-threads")
        assert code == 0, said
        with Processes(folder / f"dask-{name}-{os.getpid()}", 3) as running:
            ended, killed = threading.Event(), list[str]()

            def kill(running: Any = running, ended: Any = ended, killed: list[str] = killed) -> None:
                time.sleep(8)
                while len(killed) < 5 and not ended.wait(chance.uniform(1, 6)):
                    killed.append(victim := chance.choice(running.workers))
                    running.kill(victim)
                    running.add()

            killer = threading.Thread(target=kill)
            killer.start()
            code, _, said, took = command(
                *arguments, "--out", out / f"{name}-killed", "--cluster", running.address
            )
            ended.set()
            killer.join()
            print(
                f"{name}: {len(killed)} workers killed, exit code {code}, {took:.0f} s ({seconds:.0f} s on threads)"
            )
            print("  " + "\n  ".join(line for line in said.splitlines() if "remaining" not in line))
        compared(name, out / f"{name}-threads", out / f"{name}-killed")

    arguments, again = wanted["tune"], ("--out", out / "tune-scheduler")
    with Processes(folder / f"dask-first-{os.getpid()}", 2) as running:
        there, checkpoint = running.address, out / "tune-scheduler" / "checkpoint-000.npz"

        def end() -> None:
            while not checkpoint.exists():
                time.sleep(0.05)
            time.sleep(2.0)
            running.kill("scheduler")

        threading.Thread(target=end, daemon=True).start()
        code, _, said, took = command(*arguments, *again, "--cluster", there)
        lines = [line for line in said.splitlines() if "remaining" not in line]
        print(f"scheduler killed: exit code {code} after {took:.0f} s, {len(lines)} line(s): {lines}")
    with Processes(folder / f"dask-second-{os.getpid()}", 2) as running:
        code, _, said, _ = command(*arguments, *again, "--resume", "--cluster", running.address)
        assert code == 0, said
    compared("resumed on another cluster", out / "tune-threads", out / "tune-scheduler")


def scaling(folder: Path, repeats: int, minutes: float, generations: int) -> None:
    drives = drives_of(folder, 16, 60 * minutes)
    config: dict[str, Any] = {
        "particles": 30,
        "generations": generations,
        "model": "planar8",
        "use": EVERY_OPTION,
    }
    took: dict[int, list[float]] = {1: [], 2: []}
    worked: dict[int, list[float]] = {1: [], 2: []}
    place = folder / f"dask-{os.getpid()}"
    with (
        Processes(place / "one", 1) as one,
        Processes(place / "two", 2) as two,
        connected(one.address) as first,
        connected(two.address) as second,
    ):
        datasets = {1: remote(first, drives), 2: remote(second, drives)}
        for n, dataset in datasets.items():  # compiles, and prepares the drives
            tune(dataset, **config | {"particles": 4, "generations": 1})
            print(f"{n} worker(s): ready", flush=True)
        for _ in range(repeats):
            for n, dataset in datasets.items():
                dataset.call(forget)  # removes prepared drives, since their preparation is measured, too
                running, load = (one, two)[n - 1], os.getloadavg()[0]
                before = [running.processor(name) for name in running.workers]
                began, own = time.perf_counter(), time.process_time()
                cost = tune(dataset, **config).cost
                took[n].append(time.perf_counter() - began)
                after = [running.processor(name) for name in running.workers]
                busy = max(b - a for a, b in zip(before, after, strict=True))
                own = time.process_time() - own
                worked[n].append(busy + own)
                print(
                    f"{n} worker(s): {took[n][-1]:.1f} s (load before {load:.1f}); processor time {busy:.1f} s in the "
                    f"busiest worker, {own:.1f} s in the client; cost {cost!r}",
                    flush=True,
                )
    print(f"ratio of the best times: {min(took[1]) / min(took[2]):.2f}")
    print(f"ratio of processor seconds, busiest worker and client: {min(worked[1]) / min(worked[2]):.2f}")


def overhead(folder: Path, most: int) -> None:
    folders = drives_of(folder, DIFFERENT, 60.0)
    config = TuneConfig(model="planar8", objective="truth-rmse")
    points = np.random.default_rng(0).random((30, 20))
    print(
        "drives  an empty call, ms: median, 90%;  a generation minus the filters (30 parameter sets, planar8)"
    )
    with Processes(folder / f"dask-{os.getpid()}", 2) as running, connected(running.address) as client:
        client.wait_for_workers(2)
        for count in (count for count in (1, 10, 100, 1000) if count <= most):
            dataset = remote(client, [folders[i % DIFFERENT] for i in range(count)])
            empty = 1e3 * np.quantile([_empty_call(dataset) for _ in range(200)], [0.5, 0.9])
            problem = car_problem(dataset, config)
            low, high = problem.space.low, problem.space.high
            sets = problem.space.decode(low + points[:, : len(low)] * (high - low))
            each = [_overhead(problem.scorer, sets) for _ in range(40 if count < 1000 else 12)]
            ms = 1e3 * np.quantile(each[2:], [0.5, 0.9])
            print(f"{count:6d}  {empty[0]:8.1f} {empty[1]:8.1f}  {ms[0]:8.1f} {ms[1]:8.1f}", flush=True)


def _empty_call(dataset: RemoteDataset) -> float:
    """Return the duration (s) of an empty call of all workers."""
    began = time.perf_counter()
    dataset.call(nothing)
    return time.perf_counter() - began


def _overhead(replays: Any, sets: Sequence[Any]) -> float:
    """Return the duration (s) of a generation minus the time of the busiest worker."""
    began = time.perf_counter()
    answers = replays.dataset.call(timed, replays.passes, replays.check, costs, tuple(sets))
    return time.perf_counter() - began - max(seconds for _, (_, seconds) in answers)


def memory(folder: Path, drives: int | None) -> None:
    if drives is not None:  # in a separate process
        made = drives_of(folder, 3, 600.0)
        place = [made[i % len(made)] for i in range(drives)]
        with Processes(folder / f"dask-{os.getpid()}", 2) as running, connected(running.address) as client:
            client.wait_for_workers(2)
            time.sleep(1)
            empty = remote(client, place[:1])
            tune(
                empty, particles=4, generations=1, model="planar8", out=folder / f"memory-{os.getpid()}-first"
            )
            before = [running.memory(name) for name in running.workers]
            del empty
            tune(
                place,
                cluster=client,
                particles=6,
                generations=2,
                model="planar8",
                out=folder / f"memory-{os.getpid()}",
            )
            after = [running.memory(name) for name in running.workers]
        peak, hours = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, drives / 6
        each = (sum(after) - sum(before)) / hours / 1e6
        mb = [[round(size / 1e6) for size in sizes] for sizes in (before, after)]
        print(
            f"{drives} drives of 10 min: client's peak {peak:.0f} MB; workers {mb[0]} MB before, {mb[1]} MB after"
        )
        print(f"  {each:.0f} MB per hour of driving", flush=True)
        return
    for count in (16, 160):
        subprocess.run(
            [sys.executable, __file__, "memory", "--folder", folder, "--drives", str(count)], check=True
        )


def thousand(folder: Path) -> None:
    place = drives_of(folder, 1000, 60.0)[0].parent
    out = folder / f"thousand-{os.getpid()}"
    usual = ("--model", "planar8", "--particles", 10, "--generations", 5, "--trust-log")
    with Processes(folder / f"dask-{os.getpid()}", 2) as running:
        code, told, said, took = command("tune", place, "--out", out, *usual, "--cluster", running.address)
        print(f"{len(list(place.iterdir()))} drives: exit code {code}, {took:.0f} s")
        print("stdout:", told, "stderr:", said, sep="\n")
        suspicious = re.findall(
            r".*(?:WARNING|ERROR|CRITICAL|Traceback|garbage|large graph).*", running.log()
        )
        print("warnings in the cluster's logs:", suspicious or "none")


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "form": lambda asked: form(asked.folder, asked.drive),
    "same": lambda asked: same(asked.folder),
    "faults": lambda asked: faults(asked.folder),
    "scaling": lambda asked: scaling(asked.folder, asked.repeats, asked.minutes, asked.generations),
    "overhead": lambda asked: overhead(asked.folder, asked.drives or 1000),
    "memory": lambda asked: memory(asked.folder, asked.drives),
    "thousand": lambda asked: thousand(asked.folder),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="+", choices=PARTS)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--drive", type=Path, help="for form: a drive in CSV")
    parser.add_argument("--minutes", type=float, default=30, help="for scaling: duration of each drive")
    parser.add_argument("--generations", type=int, default=50, help="for scaling")
    parser.add_argument("--repeats", type=int, default=3, help="for scaling: number of alternating runs")
    parser.add_argument(
        "--drives", type=int, help="for overhead: largest number; for memory: number, in this process"
    )
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the processes are ended, too
    asked.folder.mkdir(parents=True, exist_ok=True)
    for part in asked.parts:
        print(f"--- {part} (load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores)", flush=True)
        PARTS[part](asked)


if __name__ == "__main__":
    main()
