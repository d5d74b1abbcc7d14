"""Run the benchmarks and write their tables into docs/benchmarks.md: `make bench`."""

import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import textwrap
from collections import defaultdict
from collections.abc import Iterator
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding as llvm

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- written by benchmarks/table.py: begin -->", "<!-- end -->"
PACKAGES = ("sigmaswarm", "numpy", "numba", "scipy", "filterpy", "pyswarms", "kalman-py", "jax", "gtsam")

FILTERS = {
    "test_filterpy": "FilterPy, predictions and updates of the drive",
    "test_textbook": "sigmaswarm's textbook filter, predictions and updates of the drive",
    "test_numba": "the textbook filter as loops in Numba, predictions and updates of the drive",
    "test_gtsam": "GTSAM's iSAM2 with attitude, 30 s of the drive (a smoother: its graph grows)",
    "test_batch": "**sigmaswarm's compiled batch of 32, predictions, updates and scores of the drive**",
}
CROWDED = {
    "test_kalman_py": "kalman-py on JAX, a fix at every IMU sample",
    "test_batch_crowded": "**sigmaswarm's compiled batch of 32, a fix at every IMU sample, with scores**",
}
CAPTIONS = (
    "**Filters.** Processor time on one core per parameter set and IMU sample. Each ratio to the last row is given as "
    "two values: the median and the lowest value over the seven rounds.",
    "**A fix at every IMU sample**, since kalman-py needs a measurement at every step. Columns as above.",
    "**Models and filter types** in the compiled batch. The ratio to planar5's UKF is the median [lowest, highest].",
    "**One tuning run**: 30 particles, 50 generations, ten minutes at 100 Hz. The ratio is given as the "
    "median and the lowest value.",
    "**Two cores.** Wall time in ms to score parameter sets over the drive, in rounds that began with both cores idle.",
    "**Live filters.** Time of one call from Python in us: the median and the 99.9% quantile. A fix is processed with "
    'the next sample, so "sample with fix" is the time of both calls. A ratio is the time of FilterPy (same filter, or '
    "planar5's UKF) divided by the time of the row: for a sample without a fix; for a sample with a fix.",
)
TUNINGS = {
    "test_tuning_pyswarms_filterpy": "PySwarms + FilterPy",
    "test_tuning_sigmaswarm": "**sigmaswarm**",
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "benchmarks.json"
        # By name: to find examples in a folder, pytest would also import rivals that are not installed.
        tests = sorted(map(str, HERE.glob("test_*.py")))
        command = [sys.executable, "-m", "pytest", *tests, "-q", "-p", "no:cacheprovider"]
        command += ["-o", "addopts=-ra --import-mode=importlib"]  # without the plugins of the tests
        command += ["--benchmark-timer=time.process_time"]  # without the time of other jobs on the core
        subprocess.run([*command, f"--benchmark-json={result}"], check=True, cwd=HERE.parent)
        measured = by_turn(json.loads(result.read_text(encoding="utf-8"))["benchmarks"])
    table = render(measured)
    print(table)
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{table}\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def by_turn(benchmarks: list[dict]) -> dict[str, list[dict]]:
    """Return the records of all rounds in order, by name: `test_kind[turn0-planar5 ekf]` is `test_kind planar5 ekf`."""
    turns = defaultdict(list)
    for benchmark in benchmarks:
        turns[re.sub(r"\[turn\d+-?(.*)\]", r" \1", benchmark["name"]).strip()].append(benchmark)
    return turns


def seconds(record: dict) -> float:
    """Return the median time (s) of a benchmark in a round, scaled to the whole job."""
    return record["stats"]["median"] * record["extra_info"]["times"]


def per_unit(record: dict) -> float:
    """Return the median time in ns per parameter set and IMU sample, or per call."""
    return record["stats"]["median"] / record["extra_info"]["work"] * 1e9


def ratio(rival: list[dict], ours: list[dict], measure) -> str:
    """Format the median and the lowest ratio over the rounds; within a round, the load of the machine is similar."""
    ratios = [measure(a) / measure(b) for a, b in zip(rival, ours, strict=True)]
    return f"{rounded(statistics.median(ratios))}; {rounded(min(ratios))}"


def render(measured: dict[str, list[dict]]) -> str:
    tables = (
        filters(measured, FILTERS, "test_batch"),
        filters(measured, CROWDED, "test_batch_crowded"),
        kinds(measured),
        tunings(measured),
        cores(measured),
        live(measured),
    )
    parts = [machine()]
    for caption, table in zip(CAPTIONS, tables, strict=True):
        parts += [textwrap.fill(caption, 120), "\n".join(table)]
    return "\n\n".join(parts)


def filters(measured: dict, labels: dict[str, str], ours: str) -> Iterator[str]:
    yield "| filter | time, ns | ratio to the last row |"
    yield "|---|---:|---:|"
    for name, label in labels.items():
        if name not in measured:
            yield f"| {label} | not installed | |"
            continue
        times = [per_unit(record) for record in measured[name]]
        compared = "1" if name == ours else ratio(measured[name], measured[ours], per_unit)
        yield f"| {label} | {number(statistics.median(times))} | {compared} |"


def kinds(measured: dict) -> Iterator[str]:
    yield "| filter | time, ns | ratio to planar5's UKF |"
    yield "|---|---:|---:|"
    ours = measured["test_kind planar5 ukf"]
    for name in (name for name in measured if name.startswith("test_kind ")):
        median = statistics.median(per_unit(record) for record in measured[name])
        yield f"| {name.removeprefix('test_kind ')} | {number(median)} | {spread(measured[name], ours)} |"


def spread(records: list[dict], ours: list[dict]) -> str:
    """Format median, lowest and highest ratio over the rounds."""
    ratios = [per_unit(a) / per_unit(b) for a, b in zip(records, ours, strict=True)]
    return f"{statistics.median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]"


def tunings(measured: dict) -> Iterator[str]:
    yield "| program | measured part | time of the whole run | ratio to sigmaswarm |"
    yield "|---|---:|---:|---:|"
    ours = measured["test_tuning_sigmaswarm"]
    for name, label in TUNINGS.items():
        records = measured[name]
        whole = statistics.median([seconds(record) for record in records])
        share = records[0]["extra_info"]["times"]
        part = "in full" if share == 1 else f"1/{share:,.0f} of the run, extrapolated"
        compared = "1" if records is ours else ratio(records, ours, seconds)
        yield f"| {label} | {part} | {duration(whole)} | {compared} |"


def cores(measured: dict) -> Iterator[str]:
    """Yield the table of two cores, without rounds in which other jobs used a core."""
    yield "| parameter sets | one core | two cores | ratio: median [lowest, highest] |"
    yield "|---:|---:|---:|---:|"
    for name in (name for name in measured if name.startswith("test_cores ")):
        every = [record["extra_info"] for record in measured[name]]
        calm = [turn for turn in every if turn["calm"]] or every
        one, two, ratios = ([turn[key] for turn in calm] for key in ("one", "two", "ratio"))
        cells = f"{statistics.median(one) * 1e3:.1f} | {statistics.median(two) * 1e3:.1f}"
        found = f"{statistics.median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]"
        yield f"| {name.removeprefix('test_cores ')} | {cells} | {found} |"


def live(measured: dict) -> Iterator[str]:
    yield "| filter | predict | update | sample with fix | ratio: same filter | ratio: planar5's UKF |"
    yield "|---|---:|---:|---:|---:|---:|"
    ours, theirs = "test_live ", "test_filterpy_calls "
    plainest = measured[theirs + "planar5 ukf"]
    rows = {name: "FilterPy, " + name.removeprefix(theirs) for name in measured if name.startswith(theirs)}
    rows |= {name: name.removeprefix(ours) for name in measured if name.startswith(ours)}
    rows["test_live_late"] = "planar5 ukf, fixes 50 ms late"
    rows["test_swarm planar8 ukf, lateral and standstill"] = (
        "LiveFilterBank of planar8 ukf, lateral and standstill"
    )
    for name, label in rows.items():
        cells = [
            "{:.2f}; {:.1f}".format(*(middle(measured[name], f"{c}_{k}") / 1e3 for k in ("median", "tail")))
            for c in ("predict", "update", "both")
        ]
        rival = measured.get(theirs + name.removeprefix(ours)) if name.startswith(ours) else None
        same = faster(rival, measured[name]) if rival else ""
        any_ = "" if name.startswith(theirs) else faster(plainest, measured[name])
        yield f"| {label} | {' | '.join([*cells, same, any_])} |"


def faster(rival: list[dict], ours: list[dict]) -> str:
    """Format the ratios of the times per sample, without and with a fix: medians over the rounds."""
    return "; ".join(
        "{:.1f}".format(
            statistics.median(
                a["extra_info"][call] / b["extra_info"][call] for a, b in zip(rival, ours, strict=True)
            )
        )
        for call in ("predict_median", "both_median")
    )


def middle(records: list[dict], key: str) -> float:
    return statistics.median(record["extra_info"][key] for record in records)


def machine() -> str:
    """Describe processor, cores and versions, without data that identify the machine."""
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES if find_spec(name.replace("-", "_")))
    return (
        f"{processor()}, {os.cpu_count()} cores, of which one is used unless stated otherwise; "
        f"Python {platform.python_version()}, {packages}."
    )


def processor() -> str:
    """Return the model's name, and the architecture for which LLVM compiles."""
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    name = found[1].strip() if found else platform.processor() or platform.machine()
    return f"{name} ({llvm.get_host_cpu_name()})"


def number(value: float) -> str:
    return f"{value:,.2f}" if value < 100 else rounded(value)


def rounded(value: float) -> str:
    """Format with three significant digits and separated thousands."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100 else f"{value:.3g}"


def duration(value: float) -> str:
    if value < 60:
        return f"{value:.2f} s"
    return f"{value / 3600:.1f} h" if value >= 3600 else f"{value / 60:.0f} min"


if __name__ == "__main__":
    main()
