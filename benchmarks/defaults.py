"""Compare the defaults of `tune` with other filters and objectives: the evidence for the defaults.

    python benchmarks/defaults.py ../shared/drives --out defaults.jsonl
    python benchmarks/defaults.py ../shared/drives --out defaults.jsonl --with-truth "truth-pose" --filters default
    python benchmarks/defaults.py ../shared/drives --out defaults.jsonl --table

Cases: each KITTI drive is held out once, and the filter is tuned on the other drives. colorado-1 and kingston-1 are
split at 70% of their time, comma2k19 in the middle; the filter is tuned on the first part and tested on the second.
colorado-1 is also used with bursts of outliers in 6% of its fixes. For each grade of sensors, the filter is tuned on
four simulated drives of 100 s and tested on three others. "A > B": tuned on A and tested on B, which has another
receiver and IMU. Each case is tuned with and without truth. Each tuning is a line of the file and is not repeated.
Prints Markdown: the scores of each tuning, medians over the seeds ("auto": the default for logs without truth); then,
for each score, the geometric mean of its ratio to the lowest score of the case, over the cases that all filters have.
Drift is the RMS over the windows of seeds 0 to 3 (5 s) and 0 to 5 (30 s).
"""

import argparse
import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from real_drives import KITTI
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, read_drive, simulate, split_time, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.simulation.gps import with_outliers
from sigmaswarm.tuning.defaults import default_filter_options, objective_for
from switches import measured, quantities, raw

CAR = ("lateral", "standstill")
WITH_TRUTH = "auto with truth"
FILTERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "planar5": ("planar5", ()),
    "planar8": ("planar8", CAR),
    "planar8 robust": ("planar8", (*CAR, "robust")),
    "planar8 gate": ("planar8", (*CAR, "gate")),
    "planar8 accuracy": ("planar8", (*CAR, "accuracy")),
    "planar8 robust accuracy": ("planar8", (*CAR, "robust", "accuracy")),
    "planar8 odometer": ("planar8", (*CAR, "odometer")),
    "planar8 robust odometer": ("planar8", (*CAR, "robust", "odometer")),
    "tilted12": ("tilted12", CAR),
    "tilted12 robust": ("tilted12", (*CAR, "robust")),
    "tilted12 odometer": ("tilted12", (*CAR, "odometer")),
    "tilted12 robust odometer": ("tilted12", (*CAR, "robust", "odometer")),
}
"""Model and options; except for planar5, all filters also use lateral and standstill."""
GROUPS = {
    "any log": ("planar5", "planar8", "planar8 robust"),
    "six axes": ("planar8", "planar8 robust", "tilted12", "tilted12 robust"),
    "odometer": ("planar8 robust", "planar8 odometer", "planar8 robust odometer"),
}
"""Filters that are compared, since the same logs support all of them."""
GRADES = {
    "mpu-6050, ublox-m8": {"imu": "mpu-6050", "gps": "ublox-m8"},
    "icm-20602, white-1m": {"imu": "icm-20602", "gps": "white-1m"},
    "icm-20602, white-1m, hilly": {"imu": "icm-20602", "gps": "white-1m", "terrain": "hilly"},
    "icm-20602, white-1m, odometer": {"imu": "icm-20602", "gps": "white-1m", "odometer": "can"},
    "adis16488, f9p-rtk": {"imu": "adis16488", "gps": "f9p-rtk"},
}
COLUMNS = ("RMSE, m", "50%, m", "95%, m", "heading, deg", "5 s, m", "30 s, m", "NIS", "NEES")
RATIOS = {"RMSE": 0, "heading": 3, "5 s drift": 4, "30 s drift": 5}
"""Compared scores (lower is better), and their columns."""
Parts = tuple[Sequence[Drive], Sequence[Drive]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="file with one line of JSON per tuning")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--with-truth", nargs="*", default=[WITH_TRUTH], help="objectives")
    parser.add_argument("--without-truth", nargs="*", default=["auto"], help="objectives")
    parser.add_argument("--filters", nargs="+", default=list(FILTERS), choices=(*FILTERS, "default"))
    parser.add_argument("--only", nargs="+", help="parts of the names of cases")
    parser.add_argument("--table", action="store_true", help="only print the results in the file")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    done = known(options.out)
    if not options.table:
        with ThreadPoolExecutor() as pool:
            for name, parts in cases(options.drives).items():
                if options.only and not any(part in name for part in options.only):
                    continue
                for seed in range(options.seeds):
                    for label in options.filters:
                        for objective in (*options.with_truth, *options.without_truth):
                            run(options.out, done, name, parts, label, objective, seed, pool)
    tables(known(options.out))


def cases(folder: Path) -> dict[str, Callable[[], Parts]]:
    """Return, by name, functions that return training and test drives, which are read or simulated only when needed."""

    @cache
    def real(name: str) -> Drive:
        return read_drive(folder / name)

    def held_out(name: str) -> Parts:
        return [real(other) for other in KITTI if other != name], [real(name)]

    def in_time(name: str, share: float = 0.7) -> Parts:
        first, rest = split_time(real(name), share)
        return [first], [rest]

    def across(training: str, test: str) -> Parts:
        return [real(training)], [real(test)]

    def far_off(drives: Sequence[Drive]) -> Drive:
        return with_outliers(drives[0], np.random.default_rng(0))

    def simulated(grade: str) -> Parts:
        made = [simulate("urban", seed=i, duration=100.0, vibration=1.0, **GRADES[grade]) for i in range(7)]
        return made[:4], made[4:]

    found: dict[str, Callable[[], Parts]] = {
        name: lambda name=name: in_time(name) for name in ("colorado-1", "kingston-1")
    }
    found["colorado-1 with outliers"] = lambda: (
        [far_off(in_time("colorado-1")[0])],
        [far_off(in_time("colorado-1")[1])],
    )
    found["colorado-1 > with outliers"] = lambda: (
        in_time("colorado-1")[0],
        [far_off(in_time("colorado-1")[1])],
    )
    found["comma2k19"] = lambda: in_time("comma2k19", 0.5)
    found |= {f"simulated {grade}": lambda grade=grade: simulated(grade) for grade in GRADES}
    found |= {name: lambda name=name: held_out(name) for name in KITTI}
    recordings = ("kitti-09-30-0033", "colorado-1", "kingston-1")
    for one in recordings:
        for other in recordings:
            if one != other:
                found[f"{one} > {other}"] = lambda one=one, other=other: across(one, other)
    found["simulated white-1m > ublox-m8"] = lambda: (
        simulated("icm-20602, white-1m")[0],
        simulated("mpu-6050, ublox-m8")[1],
    )
    return found


def run(
    out: Path,
    done: dict[tuple[str, str, str, int], list[float]],
    name: str,
    parts: Callable[[], Parts],
    label: str,
    objective: str,
    seed: int,
    pool: Executor,
) -> None:
    """Tune and score, unless the file contains the result; save a default also under the name of its filter."""
    if (name, label, objective, seed) in done:
        return None
    training, test = cached(name, parts)
    blind = [replace(drive, truth=None) for drive in training]
    if label == "default":
        chosen, _ = default_filter_options({}, [*(training if "truth" in objective else blind), *test])
        model, use = chosen["model"], chosen["use"]
        same = [each for each, filter in FILTERS.items() if filter == (model, tuple(use))]
        if same and (name, same[0], objective, seed) in done:
            return noted(out, done, (name, label, objective, seed), done[name, same[0], objective, seed])
    else:
        model, use = FILTERS[label]
        if lacking(model, use, [*training, *test]):
            return None
    if (name, "raw fixes", "-", 0) not in done:
        noted(out, done, (name, "raw fixes", "-", 0), [*quantities(raw(test))])
    if objective == WITH_TRUTH:
        taken = objective_for(training, "auto", model, use)
    else:
        taken = objective_for(blind, objective, model, use)
    tuning = tune(training, objective=taken, seed=seed, executor=pool, model=model, use=use)
    return noted(out, done, (name, label, objective, seed), figures(test, tuning.parameters))


@cache
def cached(name: str, parts: Callable[[], Parts]) -> Parts:
    return parts()


def lacking(model: str, use: Sequence[str], drives: Sequence[Drive]) -> bool:
    """Return True if a log lacks data that a filter needs."""
    return any(
        (model == "tilted12" and drive.imu.gx is None)
        or ("accuracy" in use and drive.gps.std_x is None)
        or ("odometer" in use and drive.odometer is None)
        for drive in drives
    )


def figures(test: Sequence[Drive], parameters: FilterParameters) -> list[float]:
    """Return the values of `COLUMNS` over all test drives together; NIS and NEES are means over drives."""
    scores = BatchScorer.prepare(test).scores([parameters])
    nis, nees = float(scores.mean_nis.mean()), float(scores.mean_nees.mean())
    return [*measured([PreparedDrive(drive) for drive in test], parameters), nis, nees]


def noted(
    out: Path,
    done: dict[tuple[str, str, str, int], list[float]],
    key: tuple[str, str, str, int],
    row: list[float],
) -> None:
    done[key] = row
    with out.open("a", encoding="utf-8") as file:
        file.write(json.dumps([*key, [float(f"{v:.5g}") for v in row]]) + "\n")


def known(out: Path) -> dict[tuple[str, str, str, int], list[float]]:
    """Return the scores in the file by case, filter, objective and seed."""
    if not out.exists():
        return {}
    lines = map(json.loads, out.read_text(encoding="utf-8").splitlines())
    return {(name, label, objective, seed): row for name, label, objective, seed, row in lines}


def tables(done: dict[tuple[str, str, str, int], list[float]]) -> None:
    """Print the table of all tuning runs, and the comparisons of filters."""
    median: dict[tuple[str, str, str], np.ndarray] = {}
    for name, label, objective, _ in done:
        every = [row for key, row in done.items() if key[:3] == (name, label, objective)]
        median[name, label, objective] = np.median(np.array(every), axis=0)
    print("| tested on | filter | tuned by | " + " | ".join(COLUMNS) + " |\n" + "|---" * 11 + "|")
    for (name, label, objective), row in sorted(median.items(), key=lambda item: item[0][0]):
        cells = [f"{v:.2f}" for v in row] + ["-"] * (len(COLUMNS) - len(row))
        print(f"| {name} | {label} | {objective} | " + " | ".join(cells) + " |")
    print("\n" + "\n".join(relative_to_best(median)))
    for title, rows in summaries(median):
        print(f"\n| {title} | " + " | ".join(RATIOS) + " | worst RMSE |\n" + "|---" * 6 + "|")
        for label, cells in rows:
            print(f"| {label} | " + " | ".join(f"{v:.2f}" for v in cells) + " |")


def lowest(rows: np.ndarray) -> np.ndarray:
    """Return the lowest value of each column; NaN for a column without values."""
    return np.where(
        np.isfinite(rows).any(axis=0), np.nanmin(np.where(np.isfinite(rows), rows, np.inf), axis=0), np.nan
    )


def relative_to_best(median: dict[tuple[str, str, str], np.ndarray]) -> Iterator[str]:
    """Yield ratios of the default's scores to the lowest of each case and to the raw fixes' RMSE: mean and worst."""
    yield (
        "| scores of the default / lowest scores of each case | cases | "
        + " | ".join(RATIOS)
        + " | RMSE / RMSE of the raw fixes |"
    )
    yield "|---" * (len(RATIOS) + 3) + "|"
    for objective in dict.fromkeys(o for _, label, o in median if label == "default"):
        names = [n for n, label, o in median if label == "default" and o == objective]
        rivals = [
            np.array([row for (n, _, o), row in median.items() if n == name and o == objective])
            for name in names
        ]
        own = np.array([median[name, "default", objective] for name in names])
        best = np.array([lowest(r) for r in rivals])
        share = own / best
        cells = [
            f"{np.exp(np.nanmean(np.log(one))):.2f}, at worst {np.nanmax(one):.2f}"
            for one in share[:, [*RATIOS.values()]].T
        ]
        raw_share = own[:, 0] / np.array([median[name, "raw fixes", "-"][0] for name in names])
        cells.append(f"{np.exp(np.mean(np.log(raw_share))):.2f}, at worst {raw_share.max():.2f}")
        yield f"| {objective} | {len(names)} | " + " | ".join(cells) + " |"


def summaries(
    median: dict[tuple[str, str, str], np.ndarray],
) -> Iterator[tuple[str, list[tuple[str, list[float]]]]]:
    """Yield ratios to the lowest score of each case, for filters and for objectives of the default filter."""
    tried = dict.fromkeys(objective for _, label, objective in median if label == "default")
    for truth in (True, False):
        objectives = [objective for objective in tried if ("truth" in objective) == truth]
        rivals = {
            title: [(label, objectives[0]) for label in labels]
            for title, labels in GROUPS.items()
            if objectives
        }
        rivals["the default"] = [("default", objective) for objective in objectives]
        for (title, methods), other_sensors in product(rivals.items(), (False, True)):
            names = [
                name
                for name in dict.fromkeys(name for name, *_ in median)
                if has_other_sensors(name) == other_sensors and all((name, *m) in median for m in methods)
            ]
            if len(methods) < 2 or not names:
                continue
            values = np.array([[median[name, *m] for name in names] for m in methods])
            share = values / np.array([lowest(values[:, i]) for i in range(len(names))])
            rows = []
            for (label, objective), one in zip(methods, share, strict=True):
                known_drifts = [one[np.isfinite(one[:, i]), i] for i in RATIOS.values()]
                means = [
                    float(np.exp(np.mean(np.log(each)))) if len(each) else np.nan for each in known_drifts
                ]
                rows.append((f"{label}, {objective}", [*means, float(one[:, 0].max())]))
            what = "other sensors" if other_sensors else "held out"
            yield f"{title}, {'with' if truth else 'without'} truth, {what}: {len(names)} cases", rows


def has_other_sensors(name: str) -> bool:
    """Return True if the training drives have another receiver, or if the test fixes have outliers."""
    return " > " in name or "outliers" in name


if __name__ == "__main__":
    main()
