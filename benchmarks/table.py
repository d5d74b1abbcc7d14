"""Run the benchmarks and write their table into docs/benchmarks.md: `make bench`."""

import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding as llvm

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- written by benchmarks/table.py: begin -->", "<!-- end -->"
PACKAGES = ("sigmaswarm", "numpy", "numba", "scipy", "filterpy", "pyswarms")

FILTERS = {
    "test_filterpy_predict": "FilterPy, one predict",
    "test_filterpy_update": "FilterPy, one update",
    "test_filterpy": "FilterPy, predicts and updates of the drive",
    "test_textbook": "sigmaswarm's textbook filter, the same",
    "test_batch": "**sigmaswarm's compiled batch of 32, the same, scored**",
}
TUNINGS = {
    "test_tuning_pyswarms_filterpy": "PySwarms + FilterPy",
    "test_tuning_sigmaswarm": "**sigmaswarm**",
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "benchmarks.json"
        command = [sys.executable, "-m", "pytest", str(HERE), "-q", "-p", "no:cacheprovider"]
        command += ["--benchmark-timer=time.process_time"]  # what other jobs on the core take does not count
        subprocess.run([*command, f"--benchmark-json={result}"], check=True, cwd=HERE.parent)
        measured = by_turn(json.loads(result.read_text(encoding="utf-8"))["benchmarks"])
    table = render(measured)
    print(table)
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{table}\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def by_turn(benchmarks: list[dict]) -> dict[str, list[dict]]:
    """The record of every turn, in order, by the benchmark's name."""
    turns = defaultdict(list)
    for benchmark in benchmarks:
        turns[benchmark["name"].split("[")[0]].append(benchmark)
    return turns


def seconds(record: dict) -> float:
    """The median round of a turn, scaled up to the whole job."""
    return record["stats"]["median"] * record["extra_info"]["times"]


def per_unit(record: dict) -> float:
    """The same in ns per parameter set and IMU sample, or per call."""
    return record["stats"]["median"] / record["extra_info"]["work"] * 1e9


def ratio(rival: list[dict], ours: list[dict], measure) -> str:
    """Within each turn, so that both sides had the same machine; the median and the lowest."""
    ratios = [measure(a) / measure(b) for a, b in zip(rival, ours, strict=True)]
    return f"{rounded(statistics.median(ratios))} (lowest turn {rounded(min(ratios))})"


def render(measured: dict[str, list[dict]]) -> str:
    ours = measured["test_batch"]
    lines = [
        machine(),
        "",
        "| filter | ns per parameter set and IMU sample (or call), median | fastest turn | times the batch's |",
        "|---|---:|---:|---:|",
    ]
    for name, label in FILTERS.items():
        times = [per_unit(record) for record in measured[name]]
        times_ours = "1" if name == "test_batch" else ratio(measured[name], ours, per_unit)
        lines.append(
            f"| {label} | {number(statistics.median(times))} | {number(min(times))} | {times_ours} |"
        )
    lines += [
        "",
        "| one tuning: 30 particles, 50 generations, 10 minutes at 100 Hz | measured | whole tuning | times ours |",
        "|---|---:|---:|---:|",
    ]
    ours = measured["test_tuning_sigmaswarm"]
    for name, label in TUNINGS.items():
        records = measured[name]
        whole = statistics.median([seconds(record) for record in records])
        share = records[0]["extra_info"]["times"]
        part = "in full" if share == 1 else f"1 part in {share:,.0f}, extrapolated"
        times_ours = "1" if records is ours else ratio(records, ours, seconds)
        lines.append(f"| {label} | {part} | {duration(whole)} | {times_ours} |")
    return "\n".join(lines)


def machine() -> str:
    """Processor, cores and versions; nothing that tells whose machine it is."""
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{processor()}, {os.cpu_count()} cores of which one is used; "
        f"Python {platform.python_version()}, {packages}."
    )


def processor() -> str:
    """The model's name, and the architecture that LLVM compiles for."""
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    name = found[1].strip() if found else platform.processor() or platform.machine()
    return f"{name} ({llvm.get_host_cpu_name()})"


def number(value: float) -> str:
    return f"{value:,.2f}" if value < 100 else rounded(value)


def rounded(value: float) -> str:
    """Three significant digits, with thousands separated."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100 else f"{value:.3g}"


def duration(value: float) -> str:
    if value < 60:
        return f"{value:.2f} s"
    return f"{value / 3600:.1f} h" if value >= 3600 else f"{value / 60:.0f} min"


if __name__ == "__main__":
    main()
