"""How far the filters are from each other, over a whole drive: the figures behind tests/filters/test_parity.py.

    python benchmarks/parity.py                         # a simulated drive of a minute, with a gap of 1.6 s
    python benchmarks/parity.py --drive DIR --sets 50

Errors are those of single steps, both sides restarted from the same state: the mean's relative to max(1, |x_i|),
the covariance's to sqrt(P_ii P_jj). Free runs stand beside a twin's, whose initial heading is moved by 1e-13 rad.
Takes some two minutes per 100 s of driving, nearly all of it FilterPy's.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from filters.test_parity import (
    EPS,
    Stepwise,
    compiled_against_extended,
    compiled_run,
    free_run,
    shrinkage,
    simulated,
    steps_with_fixes,
    textbook_against_filterpy,
)
from oracles.extended_ukf import ExtendedUkf, box_table, covariance_error, mean_error
from oracles.filterpy_ukf import FilterPyUkf
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.timeline import Timeline, build_timeline

QUANTILES = (0.5, 0.9, 0.99, 0.999, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drive", type=Path, help="a drive folder; a simulated drive if left out")
    parser.add_argument("--sets", type=int, default=50, help="parameter sets of the paper's box (50)")
    parser.add_argument("--slow-sets", type=int, default=10, help="how many of them FilterPy runs with (10)")
    arguments = parser.parse_args()
    console = Console(width=150, soft_wrap=False)
    drive = simulated() if arguments.drive is None else _read(arguments.drive)
    initial = initial_state(drive)
    timeline = build_timeline(drive, initial.time)
    table = box_table(arguments.sets)
    slow = table[np.linspace(0, len(table) - 1, min(arguments.slow_sets, len(table))).astype(int)]
    console.print(
        f"[bold]{drive.name}[/]: {len(timeline.dt)} steps, {len(timeline.fixes)} fixes, longest step "
        f"{timeline.dt.max():.3f} s; {len(table)} parameter sets of the paper's box, the first 32 its corners\n"
    )
    started = time.perf_counter()
    steps, notes = step_by_step(timeline, initial, table, slow)
    console.print(steps)
    console.print(*notes, "", sep="\n", highlight=False)
    console.print(free_running(timeline, initial, with_alpha(slow)))
    console.print(roots(timeline, initial, with_alpha(slow)))
    console.print(f"{time.perf_counter() - started:.0f} s")


def _read(folder: Path) -> Drive:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about gaps, which are welcome here
        return read_drive(folder)


def with_alpha(table: np.ndarray, alpha: float | None = None) -> np.ndarray:
    """The sets with one alpha for all, or by default with alpha >= 0.1."""
    chosen = table.copy()
    chosen[:, 0] = np.maximum(chosen[:, 0], 0.1) if alpha is None else alpha
    return chosen


# --- Step by step ------------------------------------------------------------------------------------------


def step_by_step(
    timeline: Timeline, initial: InitialState, table: np.ndarray, slow: np.ndarray
) -> tuple[Table, list[str]]:
    """Three rows per pair of filters: mean, covariance, sums; and what to say about the largest errors."""
    runs = {"compiled - extended": (compiled_against_extended(timeline, initial, table), 1e-9)}
    for name, theta_first, redraw in (
        ("textbook - FilterPy, theta first", True, True),
        ("textbook - FilterPy, plain root", False, True),
        ("the same, not redrawn", False, False),
    ):
        runs[name] = (
            textbook_against_filterpy(
                timeline, initial, with_alpha(slow), theta_first=theta_first, redraw=redraw
            ),
            1e-10,
        )
    for alpha in (0.1, 1e-3):
        errors = filterpy_against_extended(timeline, initial, with_alpha(slow, alpha))
        runs[f"FilterPy - extended, alpha {alpha:g}"] = errors, 1e-10
    out = _table("Step by step", "steps x sets", "over limit")
    for name, (errors, limit) in runs.items():
        _add(out, name, errors, limit)
    return out, [loss(name, errors, limit) for name, (errors, limit) in runs.items()]


def filterpy_against_extended(timeline: Timeline, initial: InitialState, table: np.ndarray) -> Stepwise:
    """FilterPy's own error, restarted from the oracle's trajectory, rounded to doubles."""
    oracle = ExtendedUkf(table)
    oracle.restart(initial.mean, initial.covariance)
    theirs = [FilterPyUkf(row, theta_first=True) for row in table]
    errors = []
    for i, fix in steps_with_fixes(timeline):
        mean, covariance = oracle.mean.astype(np.float64), oracle.covariance.astype(np.float64)
        for j, ukf in enumerate(theirs):
            ukf.restart(mean[j], covariance[j])
            _step(ukf, timeline, i, fix)
        oracle.restart(mean, covariance)
        oracle.predict(timeline.dt[i], timeline.ax[i], timeline.ay[i], timeline.gz[i], timeline.q_scale[i])
        prior = oracle.covariance
        if fix is not None:
            oracle.update(fix)
        errors.append(
            (
                mean_error(np.array([ukf.mean for ukf in theirs]), oracle.mean),
                covariance_error(np.array([ukf.covariance for ukf in theirs]), oracle.covariance),
                shrinkage(prior, oracle.covariance) if fix is not None else np.ones(len(table)),
            )
        )
    return Stepwise(*(np.array(e) for e in zip(*errors, strict=True)))


def _step(ukf: FilterPyUkf, timeline: Timeline, i: int, fix: np.ndarray | None) -> None:
    try:
        ukf.step(timeline, i, fix)
    except np.linalg.LinAlgError:  # its rounding made P indefinite
        ukf.restart(np.full(5, np.nan), np.full((5, 5), np.nan))


def _add(out: Table, name: str, errors: Stepwise, limit: float) -> None:
    for kind, values in (("mean", errors.mean), ("covariance", errors.covariance)):
        finite = values[np.isfinite(values)]
        cells = [f"{q:.1e}" for q in np.quantile(finite, QUANTILES)]
        over = f"{np.sum(finite > limit)} > {limit:g}"
        if finite.size < values.size:
            over += f", {values.size - finite.size} failed"
        out.add_row(name if kind == "mean" else "", kind, *cells, str(values.size), over)
    if errors.sums is not None:
        cells = [f"{q:.1e}" for q in np.quantile(errors.sums, QUANTILES)]
        out.add_row("", "sums", *cells, str(errors.sums.size), f"{np.sum(errors.sums > limit)} > {limit:g}")
    out.add_section()


def loss(name: str, errors: Stepwise, limit: float) -> str:
    """A sentence on covariances beyond the limit: digits that a precise fix takes from a variance."""
    over = errors.covariance > limit
    if not over.any():
        return f"{name}: no covariance beyond {limit:g}"
    most = np.max(errors.covariance[over] / (EPS * errors.shrunk[over]))
    return (
        f"{name}: {over.sum()} covariances beyond {limit:g}, in {over.any(axis=0).sum()} of {over.shape[1]} sets, "
        f"where a fix shrank a variance {errors.shrunk[over].min():.0e} to {errors.shrunk[over].max():.0e} x; "
        f"at most {most:.2g} eps x that"
    )


# --- Free running ------------------------------------------------------------------------------------------


def free_running(timeline: Timeline, initial: InitialState, table: np.ndarray) -> Table:
    """The mean's distance along whole runs."""
    out = _table("Free running: distance of the mean from the compiled filter's", "samples", "sets")
    runs = [free_run(timeline, initial, row) for row in table]
    sound = [run for run in runs if run.judged.all()]
    for name, parts in (
        ("the twin", [run.twin for run in runs]),
        ("FilterPy, theta first", [run.filterpy for run in runs]),
        ("the twin, where it stays", [run.twin[run.judged] for run in runs]),
        ("FilterPy, where the twin stays", [run.filterpy[run.judged] for run in runs]),
    ):
        values = np.concatenate(parts)
        cells = [f"{q:.1e}" for q in np.quantile(values, QUANTILES)]
        whole = f"{len(sound)} of {len(runs)} stay" if "stays" in name else str(len(runs))
        out.add_row(name, "mean", *cells, str(values.size), whole)
    return out


def roots(timeline: Timeline, initial: InitialState, table: np.ndarray) -> Table:
    """How little it matters which square root of P the sigma points are drawn from."""
    out = _table("Free running: FilterPy with its plain root, from the compiled filter", "samples", "sets")
    rows = {
        "defaults": np.array([0.1, 2, 0, *[1.0] * 7]),
        "paper": np.array([0.03, 2.5, 0.48, *[2.0] * 5, 0.1, 0.1]),
    }
    rows["careful"] = np.array([0.1, 2, 0, 1e-5, 1e-5, 1e-4, 1e-4, 1e-5, 1.0, 1.0])
    named = [(name, row[None]) for name, row in rows.items()]
    for name, group in [*named, ("sets of the box, alpha >= 0.1", table)]:
        distances = [_root_distance(timeline, initial, row) for row in group]
        values = np.concatenate(distances)
        cells = [f"{q:.1e}" for q in np.quantile(values, QUANTILES)]
        out.add_row(name, "position, m", *cells, str(values.size), str(len(group)))
    return out


def _root_distance(timeline: Timeline, initial: InitialState, row: np.ndarray) -> np.ndarray:
    """Distance (m) of FilterPy with its own root from the compiled filter, at IMU samples."""
    plain = FilterPyUkf(row, theta_first=False)
    plain.restart(initial.mean, initial.covariance)
    positions = []
    for i, fix in steps_with_fixes(timeline):
        plain.step(timeline, i, fix)
        if timeline.sampled[i]:
            positions.append(plain.mean[:2])
    ours = compiled_run(timeline, initial, row)[0][:, :2]
    return np.hypot(*(np.array(positions) - ours).T)


def _table(title: str, *last: str) -> Table:
    names: Sequence[str] = ("", "error of", "median", "90%", "99%", "99.9%", "max", *last)
    out = Table(title=title, title_justify="left", title_style="bold")
    for i, name in enumerate(names):
        out.add_column(name, justify="left" if i < 2 else "right", no_wrap=True, min_width=7)
    return out


if __name__ == "__main__":
    main()
