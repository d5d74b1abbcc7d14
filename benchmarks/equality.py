"""Run the same commands in two environments, and compare all numbers in all files that they write, bit for bit.

    python benchmarks/equality.py OLD/.venv NEW/.venv
    python benchmarks/equality.py OLD/.venv NEW/.venv --drives FOLDER --keep results
    python benchmarks/equality.py OLD/.venv NEW/.venv --only tune evaluate

The commands and options are those of version 0.3.0. Two drives are simulated; with --drives, two real drives
(kitti-09-26-0101 and colorado-1) are clipped from FOLDER. Both environments run at the same time, each in its own
folder.

A file is compared by its keys or columns. If these differ (other names or order) but the numbers are the same, the
command counts as equal and is marked as *layout*. `ALLOWED` lists the keys that may differ. Exit code 0 if all commands
are equal.
"""

import argparse
import csv
import io
import json
import math
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

TINY = "--particles 4 --generations 3 --workers 1 --trust-log"
REAL = {"kitti-09-26-0101": "30", "colorado-1": "110"}  # drive: time (s) at which it is cut
OPTIMIZERS = ("pso", "ga", "ga-pso", "de", "cma-es", "bo", "nelder-mead", "random", "sobol")
SIMULATED = ("drives/urban-clear-00", "drives/urban-clear-01")

ALLOWED = {
    r"(^|[.\[])versions?(\.|\[|$)": "versions of libraries",
    r"(^|[./_])(timings?|times\.csv|seconds|duration_of_run|elapsed)": "times taken",
    r"(^|\.)(path|folder|file|home|command)s?(\.|\[|$)": "paths",
    r"(written|created|date|stamp_of_run)": "dates",
    r"(^|[./])pages?\.html|\.png|\.svg|\.pdf": "pictures and pages",
}
"""Patterns of names of files and keys whose numbers may differ, and the contents of these files and keys."""

WORLD_TOLERANCE = 1e-8
"""Tolerance (m) of positions from latitude and longitude, since the versions use different libraries for geodesy."""


@dataclass(frozen=True)
class Step:
    """A command, and the tolerance with which its results are compared."""

    name: str
    words: str
    tolerance: float = 0.0
    logs: dict[str, str] = field(default_factory=dict[str, str])  # files to write before the command


def tuned(name: str, drives: str, options: str = "", budget: str = TINY) -> Step:
    """Return a step that tunes, by default with a tiny budget."""
    return Step(f"tune {name}", f"tune {drives} --out tuned/{name} {budget} {options}")


def logs() -> tuple[str, str, str]:
    """Return synthetic logs: IMU samples, fixes in degrees, and the NMEA sentences of a receiver."""
    rng = np.random.default_rng(3)
    t = np.arange(4000) / 100
    imu = ["stamp,forward,right,yaw"]
    imu += [
        f"{x:.2f},{a:.5f},{b:.5f},{c:.5f}"
        for x, a, b, c in zip(t, *rng.normal(0, 0.2, (3, 4000)), strict=True)
    ]
    fixes, nmea = ["seconds,latitude,longitude"], list[str]()
    for i in range(200):
        x, y = i * 0.2, 10 * i * 0.2
        lat, lon = 49 + y / 111_200 + 1e-6 * rng.normal(), 8.4 + 1e-6 * rng.normal()
        fixes.append(f"{x:.2f},{lat:.8f},{lon:.8f}")
        minutes = (f"{int(v):0{n}d}{(v - int(v)) * 60:08.5f}" for v, n in ((lat, 2), (lon, 3)))
        north, east = minutes
        clock = f"1200{x:05.2f}"
        for body in (
            f"GPGGA,{clock},{north},N,{east},E,1,10,0.9,110.0,M,47.0,M,,",
            f"GPRMC,{clock},A,{north},N,{east},E,19.4,0.0,010126,,,A",
        ):
            checksum = 0
            for letter in body.encode():
                checksum ^= letter
            nmea.append(f"${body}*{checksum:02X}")
    return "\n".join(imu) + "\n", "\n".join(fixes) + "\n", "\n".join(nmea) + "\n"


def steps(real: Sequence[str]) -> list[Step]:
    """Return the commands in an order in which the inputs of each exist."""
    a, b = SIMULATED
    both = f"{a} {b}"
    imu, fixes, nmea = logs()
    urban = "--maneuver urban --environment clear --duration 40 --gps white-1m --workers 1"
    imu_map = "--time stamp --map ax=forward ay=-right gz=yaw"
    fix_map = "gps.t=seconds lat=latitude lon=longitude"
    of_planar5 = f"run tuned/planar5 {b} --origin 49,8.4 --out"
    return [
        Step("simulate", f"simulate --out drives {urban} --runs 2 --vibration --odometer can"),
        Step("simulate, hills", f"simulate --out hills {urban} --runs 1 --terrain hilly --jitter"),
        Step("simulate, maneuvers", "simulate --out short --runs 1 --workers 1 --environment rain"),
        *(Step(f"split {d}", f"split real/{d} --out parts --at {REAL[d]}") for d in real),
        Step("doctor", " ".join(["doctor", both, *(f"parts/{d}-train" for d in real), "--json"])),
        Step("doctor --fix", f"doctor {a} --fix mended"),
        Step(
            "import csv",
            f"import imu.csv --gps gps.csv {imu_map} {fix_map} --out imported/csv",
            WORLD_TOLERANCE,
            {"imu.csv": imu, "gps.csv": fixes},
        ),
        Step(
            "import nmea",
            f"import imu.csv --gps fixes.nmea {imu_map} --gps-offset -1767268800 --out imported/nmea",
            WORLD_TOLERANCE,
            {"fixes.nmea": nmea},
        ),
        Step("convert", f"convert {both} parquet --to parquet"),
        tuned("default", both),
        tuned("trials", a, f"--trials 2 --validation {b} --racing"),
        tuned("paper", a, "--paper", budget="--workers 1 --trust-log"),
        tuned("planar5", a, "--model planar5"),
        tuned("planar8-no-truth", a, "--model planar8 --objective innovation-t"),
        tuned("planar8-ekf", a, "--model planar8 --kind ekf --use lateral odometer gate"),
        tuned("planar8", both, "--model planar8 --use-nothing"),
        *(tuned(o, a, f"--model planar5 --optimizer {o}") for o in OPTIMIZERS),
        *(tuned(d, f"parts/{d}-train") for d in real),
        Step("evaluate", f"evaluate tuned/default {b} --out evaluated/plain --trust-log"),
        Step("evaluate --json", f"evaluate tuned/default {b} --json --trust-log"),
        Step(
            "evaluate --against",
            f"evaluate tuned/default {b} --against tuned/planar5 --out evaluated/two --trust-log",
        ),
        Step(
            "evaluate --smooth --swarm",
            f"evaluate tuned/planar5 {b} --smooth --swarm --out evaluated/more --trust-log",
        ),
        *(
            Step(f"evaluate {d}", f"evaluate tuned/{d} parts/{d}-train --out evaluated/{d} --trust-log")
            for d in real
        ),
        Step("report", "report evaluated/two"),
        *(Step(f"run .{e}", f"run tuned/default {b} --out run.{e}") for e in ("csv", "mat", "tum", "kitti")),
        *(
            Step(f"run .{e}", f"{of_planar5} run.{e}", WORLD_TOLERANCE)
            for e in ("geojson", "gpx", "kml", "ros2")
        ),
        Step("run --smooth", f"run tuned/default {b} --out smooth.csv --smooth"),
        Step("run --swarm", f"run tuned/planar5 {b} --out swarm.csv --swarm"),
        Step("export filterpy", "export tuned/planar5 --to filterpy --out exported/py"),
        Step("export c99", f"export tuned/default --to c99 --out exported/c --replay {b}"),
        Step("export robot_localization", "export tuned/planar5 --to robot_localization --out exported/ros"),
        Step("reference", f"reference {a} --fixes {a} --out reference --accuracy 3"),
        Step("plot", f"plot {a} --out drive.png"),
        Step(
            "compare",
            f"compare {a} --validation {b} --optimizers pso de --model planar5 --particles 3 --generations 2 "
            "--seeds 3 --workers 1 --out compared",
        ),
        Step(
            "study",
            f"study --drives {both} hills/urban-clear-00 --out study --trials 2 --particles 2 --generations 1 "
            "--workers 1",
        ),
        Step("learn", f"learn noise-gru tuned/planar8 {a} --out learned"),
        Step("evaluate a network", f"evaluate learned {b} --json --trust-log"),
    ]


# --- numbers of files -------------------------------------------------------------------------------------------------

Numbers = dict[str, float | str]
_NUMBER = re.compile(
    r"(?<![\w.])[-+]?(?:0[xX][0-9a-fA-F.]+(?:[pP][-+]?\d+)?|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
)


def flattened(value: Any, key: str = "") -> Iterator[tuple[str, float | str]]:
    """Yield the numbers of nested tables by their keys."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from flattened(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from flattened(inner, f"{key}[{i}]")
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "fiub":
            for i, inner in enumerate(value.astype(float).ravel()):
                yield f"{key}[{i}]", float(inner)
        elif value.dtype.kind == "U" and value.size == 1 and str(value).startswith(("{", "[")):
            with suppress(json.JSONDecodeError):  # otherwise, the text is not JSON
                yield from flattened(json.loads(str(value)), key)
    elif isinstance(value, (int, float)):
        yield key, float(value)


def numbers_of(path: Path) -> Numbers:
    """Return the numbers of a file by their keys; for an unknown format, the numbers in its text, or its bytes."""
    suffix = path.suffix.lower()
    content = path.read_bytes()
    if suffix == ".npz":
        with np.load(path) as arrays:
            return dict(flattened({name: arrays[name] for name in sorted(arrays.files)}))
    if suffix in (".json", ".geojson"):
        return dict(flattened(json.loads(content)))
    if suffix == ".toml":
        return dict(flattened(tomllib.loads(content.decode())))
    if suffix == ".csv":
        return _of_csv(content.decode())
    if suffix == ".parquet":
        import polars as pl

        return dict(flattened(pl.read_parquet(path).to_dict(as_series=False)))
    if suffix == ".mat":
        from scipy.io import loadmat

        return dict(flattened({k: v for k, v in loadmat(path).items() if not k.startswith("__")}))
    if suffix in (".gpx", ".kml"):
        tree = ElementTree.fromstring(content)
        texts = [
            t for e in tree.iter() if not e.tag.endswith("time") for t in (*e.attrib.values(), e.text or "")
        ]
        return _of_text(" ".join(texts))
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return {f"bytes[{i}]": content[i : i + 64].hex() for i in range(0, len(content), 64)}
    return _of_text(text)


def _of_csv(text: str) -> Numbers:
    rows = [row for row in csv.reader(io.StringIO(text)) if row]
    head = rows[0] if rows else []
    if all(_NUMBER.fullmatch(cell) for cell in head):
        return {f"[{i}][{j}]": float(c) for i, row in enumerate(rows) for j, c in enumerate(row)}
    cells = (
        (f"{name}[{i}]", cell)
        for i, row in enumerate(rows[1:])
        for name, cell in zip(head, row, strict=False)
    )
    return {key: float(cell) for key, cell in cells if _NUMBER.fullmatch(cell)}


def _of_text(text: str) -> Numbers:
    without_comments = re.sub(
        r"/\*.*?\*/|//[^\n]*|^\s*#(?!define)[^\n]*", " ", text, flags=re.DOTALL | re.MULTILINE
    )
    found = _NUMBER.findall(without_comments)
    return {
        f"number[{i}]": (float.fromhex(n) if "0x" in n.lower() else float(n)) for i, n in enumerate(found)
    }


def is_allowed(file: str, key: str) -> bool:
    """Return True if a number may differ."""
    return any(re.search(pattern, key) or re.search(pattern, file) for pattern in ALLOWED)


def same(a: float | str, b: float | str, tolerance: float) -> bool:
    """Compare two numbers; NaN equals NaN, and -0 does not equal 0 without a tolerance."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    if math.isnan(a) or math.isnan(b):
        return math.isnan(a) and math.isnan(b)
    if tolerance:
        return abs(a - b) <= tolerance
    return a == b and math.copysign(1, a) == math.copysign(1, b)


@dataclass
class Compared:
    """Result of a comparison."""

    numbers: int = 0
    layout: list[str] = field(default_factory=list[str])
    differences: list[str] = field(default_factory=list[str])


def compare_files(old: Path, new: Path, name: str, tolerance: float, found: Compared) -> None:
    """Compare the numbers of two files."""
    pair = [{k: v for k, v in numbers_of(p).items() if not is_allowed(name, k)} for p in (old, new)]
    before, after = pair
    found.numbers += len(before)
    if before.keys() != after.keys():
        if Counter(map(repr, before.values())) == Counter(map(repr, after.values())):
            found.layout.append(name)
        else:
            gone, added = before.keys() - after.keys(), after.keys() - before.keys()
            found.differences.append(
                f"{name}: {len(gone)} keys gone {_few(gone)}, {len(added)} new {_few(added)}"
            )
    unequal = [k for k in before.keys() & after.keys() if not same(before[k], after[k], tolerance)]
    if unequal:
        first = min(unequal, key=lambda key: list(before).index(key))
        values = f"{before[first]!r}, now {after[first]!r}"
        found.differences.append(f"{name}: {len(unequal)} numbers differ, first {first}: {values}")


def _few(keys: set[str]) -> str:
    return ", ".join(sorted(keys)[:3])


def compare_folders(old: Path, new: Path, tolerance: float) -> Compared:
    """Compare all files that are new in two folders."""
    found = Compared()
    files = [{str(p.relative_to(top)) for p in top.rglob("*") if p.is_file()} for top in (old, new)]
    for name in sorted(files[0] | files[1]):
        if is_allowed(name, ""):
            continue
        if name not in files[1] or name not in files[0]:
            found.differences.append(f"{name}: only in {'old' if name in files[0] else 'new'}")
            continue
        try:
            compare_files(old / name, new / name, name, tolerance, found)
        except (ValueError, KeyError, ElementTree.ParseError) as error:
            found.differences.append(f"{name}: can't be compared: {error}")
    return found


# --- running ----------------------------------------------------------------------------------------------------------


def run_step(step: Step, environment: Path, folder: Path) -> tuple[int, str, float]:
    """Run a command in the folder of an environment; return exit code, end of its messages, and duration, s."""
    for name, text in step.logs.items():
        (folder / name).write_text(text)
    begun = time.perf_counter()
    done = subprocess.run(
        [str(environment / "bin/sigmaswarm"), *step.words.split()],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if "--json" in step.words.split():
        printed = folder / "printed"
        printed.mkdir(exist_ok=True)
        (printed / f"{step.name}.json").write_text(done.stdout)
    return done.returncode, done.stderr.strip()[-300:], time.perf_counter() - begun


def snapshot(folder: Path) -> dict[str, float]:
    """Return the modification times of the files in a folder."""
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def moved(folder: Path, before: dict[str, float], to: Path) -> None:
    """Link the files that a step wrote into a separate folder."""
    for name, stamp in snapshot(folder).items():
        if before.get(name) != stamp:
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            (to / name).hardlink_to(folder / name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--drives", type=Path, help="folder of real drives")
    parser.add_argument(
        "--only", nargs="*", help="beginnings of the names of steps, which must not need other steps"
    )
    parser.add_argument("--keep", type=Path, help="folder for the results; by default a temporary folder")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        top = (asked.keep or Path(temporary)).resolve()
        sides = [(path.resolve(), top / name) for path, name in ((asked.old, "old"), (asked.new, "new"))]
        real = [d for d in REAL if asked.drives and (asked.drives / d).is_dir()]
        for _, folder in sides:
            (folder / "work").mkdir(parents=True)
            if real:
                (folder / "work/real").symlink_to(asked.drives.resolve())
        chosen = [s for s in steps(real) if not asked.only or s.name.startswith(tuple(asked.only))]
        unequal = sum(not _one(step, i, sides) for i, step in enumerate(chosen))
    print(f"\n{len(chosen)} commands, {len(chosen) - unequal} equal, {unequal} not")
    sys.exit(unequal > 0)


def _one(step: Step, number: int, sides: list[tuple[Path, Path]]) -> bool:
    """Run a step in both environments, compare, and print a line of the table."""
    before = [snapshot(folder / "work") for _, folder in sides]
    with ThreadPoolExecutor(2) as pool:
        ended = list(pool.map(lambda side: run_step(step, side[0], side[1] / "work"), sides))
    results = [folder / "steps" / str(number) for _, folder in sides]
    for (_, folder), past, to in zip(sides, before, results, strict=True):
        to.mkdir(parents=True)
        moved(folder / "work", past, to)
    found = compare_folders(*results, step.tolerance)
    codes = [code for code, _, _ in ended]
    if codes[0] != codes[1] or codes[0] not in (0, 1):
        found.differences.append(f"exit codes {codes}: {ended[0][1]} | {ended[1][1]}")
    note = f"layout: {', '.join(found.layout[:2])}" if found.layout else ""
    if step.tolerance and not found.differences:
        note += f" within {step.tolerance:g}"
    seconds = "  ".join(f"{s:5.1f}" for _, _, s in ended)
    verdict = "NOT EQUAL" if found.differences else "equal"
    print(f"{step.name:34} {verdict:10} {found.numbers:9,} numbers  {seconds} s  {note}", flush=True)
    for line in found.differences[:5]:
        print(f"    {line}", flush=True)
    return not found.differences


if __name__ == "__main__":
    main()
