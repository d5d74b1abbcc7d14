"""Measure the differences between the filters over a whole drive: the figures for tests/filters/test_parity.py.

    python benchmarks/parity.py                         # a simulated minute in town, with a gap and standstills
    python benchmarks/parity.py --drive DIR --sets 64

Errors are those of single steps from the same state: of the mean, relative to max(1, |x_i|); of the covariance,
relative to sqrt(P_ii P_jj). Free runs are compared with a twin, whose initial heading differs by 1e-13 rad. Takes about
two minutes per 60 s of driving, mostly for FilterPy.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from filter_cases import KINDS
from free_running import compiled_run, filterpy_run, free_run
from oracles.box import as_parameters, box_sets, box_table
from oracles.extended import Extended, covariance_error, mean_error
from oracles.extended_filters import ExtendedCar
from oracles.filterpy_car import FilterPyCar
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.events import FIX, IMU
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.parameters import FilterParameters
from stepwise import (
    EPS,
    Stepwise,
    compiled_against_extended,
    equipped,
    heading_std,
    on_time_line,
    shrinkage,
    steps_with_fixes,
    textbook_against_filterpy,
    urban,
)

Sets = list[FilterParameters]
QUANTILES = (0.5, 0.9, 0.99, 0.999, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drive", type=Path, help="a drive folder; a simulated drive if left out")
    parser.add_argument(
        "--sets", type=int, default=64, help="number of planar5 UKFs within the paper's bounds (64)"
    )
    parser.add_argument(
        "--car-sets", type=int, default=16, help="number of sets of each filter type and model (16)"
    )
    parser.add_argument(
        "--slow-sets", type=int, default=5, help="number of these sets with which FilterPy runs (5)"
    )
    arguments = parser.parse_args()
    if arguments.sets % LANES or arguments.car_sets % LANES:
        parser.error(f"--sets and --car-sets must be multiples of {LANES}")
    console = Console(width=190, soft_wrap=False)
    drive = urban(0.0, 60.0) if arguments.drive is None else _read(arguments.drive)
    plain = replace(drive, metadata={**drive.metadata, "gps_lever_arm_m": [0.0, 0.0, 0.0]})
    timeline, initial = on_time_line(plain)
    table = box_table(arguments.sets)
    slow = table[np.linspace(0, len(table) - 1, arguments.slow_sets).astype(int)]
    console.print(
        f"[bold]{drive.name}[/]: {len(timeline.dt)} steps, {len(timeline.fixes)} fixes, longest step "
        f"{timeline.dt.max():.3f} s, stands in {timeline.stands.sum()} steps\n"
    )
    started = time.perf_counter()
    console.print(every_filter(equipped(drive), arguments.car_sets))
    steps, notes = step_by_step(timeline, initial, table, slow)
    console.print(steps)
    console.print(*notes, "", sep="\n", highlight=False)
    console.print(free_running(timeline, initial, with_alpha(slow)))
    console.print(roots(timeline, initial, with_alpha(slow)))
    console.print(f"{time.perf_counter() - started:.0f} s")


def _read(folder: Path) -> Drive:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about gaps, which are part of the test
        return read_drive(folder)


def with_alpha(table: np.ndarray, alpha: float | None = None) -> Sets:
    """Return the sets with the given alpha or, by default, with alpha >= 0.1."""
    chosen = table.copy()
    chosen[:, 0] = np.maximum(chosen[:, 0], 0.1) if alpha is None else alpha
    return as_parameters(chosen)


# --- Step by step ------------------------------------------------------------------------------------------


def every_filter(drive: Drive, n_sets: int) -> Table:
    """Compare all filters with extended precision, separately for heading standard deviations below and above 1 rad."""
    timeline, initial = on_time_line(drive)
    out = _table("Compiled - extended, all measurements", "heading", "steps x sets", "over limit")
    for model, kind in product(("planar5", "planar8"), KINDS):
        errors = compiled_against_extended(timeline, initial, box_sets(model, kind, n_sets))
        failed = f", {np.isinf(errors.turn).any(axis=0).sum()} sets failed"
        lost = ~errors.known & np.isfinite(errors.turn)
        for heading, part, rest in (("known", errors.known, ""), ("lost", lost, failed)):
            for name, values in (("mean", errors.mean[part]), ("covariance", errors.covariance[part])):
                over = f"{np.sum(values > 1e-9)} > 1e-09" + (rest if name == "covariance" else "")
                label = f"{model} {kind}" if name == "mean" else ""
                out.add_row(label, name, *_cells(values), heading, str(values.size), over)
        for name, values in (("sums", errors.sums), ("adapted Q, R", errors.noise)):
            if values is not None and values.size:
                chosen = values[errors.known[errors.absorbed]]
                over = f"{np.sum(chosen > 1e-9)} > 1e-09"
                out.add_row("", name, *_cells(chosen), "known", str(chosen.size), over)
        most = errors.beyond(1e-9, 1)[errors.known].max()
        out.add_row("", "cov. / max(1e-9, eps x shrunk)", *[""] * 4, f"{most:.2g}", "known", "", "")
        out.add_section()
    return out


def step_by_step(
    timeline: Timeline, initial: InitialState, table: np.ndarray, slow: np.ndarray
) -> tuple[Table, list[str]]:
    """Return a table of the errors of each pair of filters, and sentences on the largest errors."""
    runs = {"compiled - extended": (compiled_against_extended(timeline, initial, as_parameters(table)), 1e-9)}
    for name, theta_first, redraw in (
        ("textbook - FilterPy, theta first", True, True),
        ("textbook - FilterPy, plain root", False, True),
        ("the same, not redrawn", False, False),
    ):
        errors = textbook_against_filterpy(
            timeline, initial, with_alpha(slow), theta_first=theta_first, redraw=redraw
        )
        runs[name] = errors, 1e-10
    ekf = [replace(p, kind="ekf") for p in with_alpha(slow)]
    errors = textbook_against_filterpy(timeline, initial, ekf, theta_first=True)
    runs["textbook - FilterPy, extended filter"] = errors, 1e-10
    for alpha in (0.1, 1e-3):
        errors = filterpy_against_extended(timeline, initial, with_alpha(slow, alpha))
        runs[f"FilterPy - extended, alpha {alpha:g}"] = errors, 1e-10
    out = _table(
        "Single steps of planar5, no lever arm, within the paper's bounds", "steps x sets", "over limit"
    )
    for name, (errors, limit) in runs.items():
        _add(out, name, errors, limit)
    return out, [loss(name, errors, limit) for name, (errors, limit) in runs.items()]


def filterpy_against_extended(timeline: Timeline, initial: InitialState, sets: Sets) -> Stepwise:
    """Return FilterPy's errors; each step starts from the state in extended precision, rounded to double."""
    oracle, errors = ExtendedCar(timeline, sets), []
    oracle.mean = np.tile(initial.mean, (len(sets), 1))
    oracle.covariance = np.tile(initial.covariance, (len(sets), 1, 1))
    theirs = [FilterPyCar(timeline, p, theta_first=True) for p in sets]
    for i, fix in steps_with_fixes(timeline):
        mean, covariance = oracle.mean.astype(np.float64), oracle.covariance.astype(np.float64)
        happens = IMU if fix is None else FIX
        for j, ukf in enumerate(theirs):
            ukf.restart(mean[j], covariance[j])
            _step(ukf, i, happens, fix)
        oracle.mean, oracle.covariance = mean.astype(Extended), covariance.astype(Extended)
        oracle.step(i, happens, fix)
        errors.append(
            (
                mean_error(np.array([ukf.mean for ukf in theirs]), oracle.mean),
                covariance_error(np.array([ukf.covariance for ukf in theirs]), oracle.covariance),
                shrinkage(oracle.prior, oracle.covariance),
                heading_std(oracle.prior, np.ones(len(sets), dtype=bool)),
            )
        )
    return Stepwise(*(np.array(e) for e in zip(*errors, strict=True)))


def _step(ukf: FilterPyCar, i: int, happens: int, fix: np.ndarray | None) -> None:
    try:
        ukf.step(i, happens, fix)
    except np.linalg.LinAlgError:  # P is indefinite due to rounding
        ukf.restart(np.full(5, np.nan), np.full((5, 5), np.nan))


def _add(out: Table, name: str, errors: Stepwise, limit: float) -> None:
    for kind, values in (("mean", errors.mean), ("covariance", errors.covariance)):
        finite = values[np.isfinite(values)]
        cells = _cells(finite)
        over = f"{np.sum(finite > limit)} > {limit:g}"
        if finite.size < values.size:
            over += f", {values.size - finite.size} failed"
        out.add_row(name if kind == "mean" else "", kind, *cells, str(values.size), over)
    if errors.sums is not None:
        cells = _cells(errors.sums)
        out.add_row("", "sums", *cells, str(errors.sums.size), f"{np.sum(errors.sums > limit)} > {limit:g}")
    out.add_section()


def _cells(values: np.ndarray) -> list[str]:
    return [f"{q:.1e}" for q in np.quantile(values, QUANTILES)] if values.size else [""] * len(QUANTILES)


def loss(name: str, errors: Stepwise, limit: float) -> str:
    """Return a sentence on covariances whose error exceeds the limit after a fix that reduces a variance strongly."""
    over = errors.covariance > limit
    if not over.any():
        return f"{name}: no covariance error above {limit:g}"
    most = np.max(errors.covariance[over] / (EPS * errors.shrunk[over]))
    return (
        f"{name}: {over.sum()} covariance errors above {limit:g}, in {over.any(axis=0).sum()} of {over.shape[1]} sets, "
        f"after fixes that divide a variance by {errors.shrunk[over].min():.0e} to {errors.shrunk[over].max():.0e}; "
        f"at most {most:.2g} eps x this divisor"
    )


# --- Free running ------------------------------------------------------------------------------------------


def free_running(timeline: Timeline, initial: InitialState, sets: Sets) -> Table:
    """Return a table of the distances between means along whole runs."""
    out = _table("Whole runs: distance of the mean from that of the compiled filter", "samples", "sets")
    runs = [free_run(timeline, initial, p) for p in sets]
    sound = [run for run in runs if run.judged.all()]
    for name, parts in (
        ("the twin", [run.twin for run in runs]),
        ("FilterPy, theta first", [run.filterpy for run in runs]),
        ("the twin, below the limit", [run.twin[run.judged] for run in runs]),
        ("FilterPy, twin below the limit", [run.filterpy[run.judged] for run in runs]),
    ):
        values = np.concatenate(parts)
        cells = _cells(values)
        whole = f"{len(sound)} of {len(runs)} below" if "below" in name else str(len(runs))
        out.add_row(name, "mean", *cells, str(values.size), whole)
    return out


def roots(timeline: Timeline, initial: InitialState, sets: Sets) -> Table:
    """Return a table of the effect of the square root of P from which sigma points are drawn."""
    out = _table(
        "Whole runs: distance of FilterPy with its own root of P from the compiled filter", "samples", "sets"
    )
    rows = {
        "defaults": np.array([0.1, 2, 0, *[1.0] * 7]),
        "paper": np.array([0.03, 2.5, 0.48, *[2.0] * 5, 0.1, 0.1]),
    }
    rows["careful"] = np.array([0.1, 2, 0, 1e-5, 1e-5, 1e-4, 1e-4, 1e-5, 1.0, 1.0])
    named = [(name, as_parameters(row[None])) for name, row in rows.items()]
    for name, group in [*named, ("random sets, alpha >= 0.1", sets)]:
        distances = [_root_distance(timeline, initial, p) for p in group]
        values = np.concatenate(distances)
        cells = _cells(values)
        out.add_row(name, "position, m", *cells, str(values.size), str(len(group)))
    return out


def _root_distance(timeline: Timeline, initial: InitialState, p: FilterParameters) -> np.ndarray:
    """Return the distances (m) between FilterPy with its own root and the compiled filter at the IMU samples."""
    theirs = filterpy_run(timeline, initial, p, theta_first=False)[0][:, :2]
    ours = compiled_run(timeline, initial, p)[0][:, :2]
    return np.hypot(*(theirs - ours).T)


def _table(title: str, *last: str) -> Table:
    names: Sequence[str] = ("", "error of", "median", "90%", "99%", "99.9%", "max", *last)
    out = Table(title=title, title_justify="left", title_style="bold")
    for i, name in enumerate(names):
        out.add_column(name, justify="left" if i < 2 else "right", no_wrap=True, min_width=7)
    return out


if __name__ == "__main__":
    main()
