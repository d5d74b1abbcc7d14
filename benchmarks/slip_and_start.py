"""Measure the effects of tire slip and of the alignment's estimate of the tilts, alone and together.

    python benchmarks/slip_and_start.py ../shared/drives --out slip.jsonl
    python benchmarks/slip_and_start.py ../shared/drives --out slip.jsonl --table

The cases are the 13 held-out cases of `defaults.py`. Every filter is tuned with the defaults, with truth (T) and
without (B), from the initial states of the alignment: with `tire_slip` 0 ("no slip"), with `--use slip` ("slip"), and
with a fixed `tire_slip` (its value). Each filter is tested from the initial state of the alignment with its estimate of
the tilts ("window") and without it ("level"). With `--every S`, the test drives are the parts of up to 100 s that begin
every S s and last at least 45 s, so that there are many starts. With `--fresh N`, drives with simulated white fix
errors are also tested with N other realizations of these errors, since one realization hides effects below 5%. Each
tuning and each row of scores is a line of the file, and is not repeated. Prints Markdown: medians over the seeds; then
the geometric mean of the ratios to the default with the same seed and fixes, and the largest mean ratio of a case.
Drifts are RMS over all placements of the outages.
"""

import argparse
import json
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from defaults import cached, cases, has_other_sensors
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, initial_state, tune
from sigmaswarm.drives.alignment import StartFailure, find_start
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.split import clip
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.drifts import OutageDrifts
from sigmaswarm.scoring.score import MIN_HEADING_SPEED
from sigmaswarm.tuning import problem
from sigmaswarm.tuning.defaults import default_filter_options
from switches import quantities

TUNINGS = ("no slip", "slip", "0.003", "0.005")
SHORTEST, LONGEST = 45.0, 100.0  # s, length of a part with `--every`
WHITE = ("kitti-09-26", "kitti-09-30-0018", "kitti-09-30-0033", "colorado-1", "white-1m")
"""Parts of the names of cases in which the fixes are the truth plus white errors of 1 m per axis."""
COLUMNS = (
    *("RMSE, m", "50%, m", "95%, m", "heading, deg", "5 s, m", "30 s, m", "NIS", "NEES"),
    *("smoothed RMSE, m", "smoothed heading, deg"),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", help="parts of cases' names")
    parser.add_argument("--tunings", nargs="+", default=TUNINGS[:2], choices=TUNINGS)
    parser.add_argument("--fresh", type=int, default=0, help="number of realizations of the fix errors")
    parser.add_argument("--every", type=float, help="s between starts in a test drive")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    if not options.table:
        with ThreadPoolExecutor() as pool:
            parts = {name: of for name, of in cases(options.drives).items() if not has_other_sensors(name)}
            names = [name for name in parts if any(part in name for part in options.only or [""])]
            for seed, name, known, slip in product(range(options.seeds), names, "TB", options.tunings):
                case = (name, *cached(name, parts[name]))
                tuned = tuning(options.out, case, known, slip, seed, pool)
                case = (*case[:2], [part for drive in case[2] for part in begun(drive, options.every)])
                score(options.out, case, (known, slip, seed), tuned, options.fresh)
    table(lines(options.out))


def tuning(
    out: Path, case: Any, known: str, slip: str, seed: int, pool: ThreadPoolExecutor
) -> FilterParameters:
    """Tune, or read the saved tuning."""
    name, training, test = case
    done, key = lines(out), (name, known, slip, seed, "tuning")
    if key in done:
        return FilterParameters(**done[key])
    drives = training if known == "T" else [replace(drive, truth=None) for drive in training]
    chosen, _ = default_filter_options({}, [*drives, *test])
    use = (*chosen["use"], *(("slip",) if slip == "slip" else ()))
    search_space = problem.search_space

    def fixed(*args: Any, **options: Any) -> Any:
        space = search_space(*args, **options)
        return replace(space, fixed={**space.fixed, "tire_slip": float(slip)})

    with mock.patch.object(problem, "search_space", fixed if "slip" not in slip else search_space):
        tuned = tune(drives, seed=seed, executor=pool, model=chosen["model"], use=use).parameters
    note(out, key, tuned.to_dict())
    return tuned


def score(
    out: Path, case: Any, which: tuple[str, str, int], parameters: FilterParameters, fresh: int
) -> None:
    """Score a tuning from both starts, with the fixes of the drives and with other realizations."""
    name, _, test = case
    done = lines(out)
    for i in range(1 + (fresh if any(part in name for part in WHITE) and "outliers" not in name else 0)):
        drives = [renewed(drive, i) for drive in test] if i else test
        for start in ("level", "window"):
            key = (name, *which, f"{start}, fresh {i}" if i else start)
            if key not in done:
                found = [initial_state(drive) for drive in drives]
                found = [replace(one, tilt=None) for one in found] if start == "level" else found
                ready = [PreparedDrive(drive, one) for drive, one in zip(drives, found, strict=True)]
                note(out, key, figures(ready, parameters))


def begun(drive: Drive, every: float | None) -> list[Drive]:
    """Return the drive or, with ``every`` (s), the parts that begin at this interval and have a start."""
    if every is None:
        return [drive]
    first, last = drive.imu.time[[0, -1]]
    parts = [clip(drive, start, start + LONGEST) for start in np.arange(first, last - SHORTEST, every)]
    return [part for part in parts if not isinstance(find_start(part), StartFailure)]


def renewed(drive: Drive, seed: int) -> Drive:
    """Return the drive with another realization of the white errors of its fixes, 1 m per axis."""
    gps, truth = drive.gps, drive.truth
    assert truth is not None
    inside = (gps.time >= truth.time[0]) & (gps.time <= truth.time[-1])
    theta = np.interp(gps.time, truth.time, np.unwrap(truth.theta))
    (forward, left), c, s = drive.lever_arm, np.cos(theta), np.sin(theta)
    x = np.interp(gps.time, truth.time, truth.x) + c * forward - s * left
    y = np.interp(gps.time, truth.time, truth.y) + s * forward + c * left
    x, y = np.array([x, y]) + np.random.default_rng(1000 + seed).normal(size=(2, len(x)))
    return replace(drive, gps=replace(gps, x=np.where(inside, x, gps.x), y=np.where(inside, y, gps.y)))


def figures(test: Sequence[PreparedDrive], parameters: FilterParameters) -> list[float]:
    """Return the scores in the order of `COLUMNS`, over all test drives together."""
    off, turned = zip(*(errors(one.drive, run_filter(one, parameters)) for one in test), strict=True)
    after, faced = zip(*(errors(one.drive, smooth(one, parameters)) for one in test), strict=True)
    found = BatchScorer.prepare(test).scores([parameters])
    return [
        *quantities(np.concatenate(off)),
        rms_deg(turned),
        *(drift(test, parameters, length) for length in (5.0, 30.0)),
        float(found.mean_nis.mean()),
        float(found.mean_nees.mean()),
        quantities(np.concatenate(after))[0],
        rms_deg(faced),
    ]


def rms_deg(turned: Sequence[np.ndarray]) -> float:
    return float(np.degrees(np.sqrt(np.mean(np.concatenate(turned) ** 2))))


def errors(drive: Drive, estimate: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return position errors (m) and scored heading errors (rad) at the times of the truth."""
    truth = drive.truth
    assert truth is not None
    scored = truth.select((truth.time >= estimate.time[0]) & (truth.time <= estimate.time[-1]))
    x, y = (np.interp(scored.time, estimate.time, estimate.mean[:, i]) for i in (0, 1))
    theta = np.interp(scored.time, estimate.time, np.unwrap(estimate.mean[:, 4]))
    counts = np.hypot(scored.vx, scored.vy) > MIN_HEADING_SPEED
    return np.hypot(x - scored.x, y - scored.y), wrap_angle(theta - scored.theta)[counts]


def drift(test: Sequence[PreparedDrive], parameters: FilterParameters, length: float) -> float:
    """Return the RMS drift (m) over the drives and all placements of outages of a length (s)."""
    each = []
    for one in test:
        outages = OutageDrifts(one, length=length, seed=0)
        outages.run({"tuned": parameters}, monitored=False)
        each.append(outages.drift("tuned"))
    return float(np.sqrt(np.nanmean(np.square(each))))


def lines(out: Path) -> dict[tuple[Any, ...], Any]:
    if not out.exists():
        return {}
    return {tuple(key): value for key, value in map(json.loads, out.read_text(encoding="utf-8").splitlines())}


def note(out: Path, key: tuple[Any, ...], value: Any) -> None:
    with out.open("a", encoding="utf-8") as file:
        file.write(json.dumps([key, value]) + "\n")


def table(done: dict[tuple[Any, ...], Any]) -> None:
    """Print medians over seeds and realizations, and geometric means of paired ratios to the default."""
    rows: dict[tuple[str, ...], dict[tuple[int, str], Any]] = {}
    for (name, known, slip, seed, what), value in done.items():
        if what != "tuning":
            start, _, realization = what.partition(", ")
            kind = f"{start}, fresh" if realization else start
            rows.setdefault((known, slip, kind, name), {})[seed, realization] = np.array(value)
    print("| truth | tuning | start | tested on | " + " | ".join(COLUMNS) + " |")
    print("|---" * (len(COLUMNS) + 4) + "|")
    for key, row in sorted(rows.items()):
        median = np.median([*row.values()], axis=0)
        print("| " + " | ".join(key) + " | " + " | ".join(f"{v:.3f}" for v in median) + " |")
    for known, slip, kind in dict.fromkeys(key[:3] for key in rows):
        share = []
        for (*which, name), row in rows.items():
            if which == [known, slip, kind]:
                default = rows.get((known, "no slip", kind.replace("level", "window"), name), {})
                paired = [np.log(row[one] / default[one]) for one in row if one in default]
                share += [np.mean(paired, axis=0)] if paired else []
        mean, most = np.exp(np.nanmean(share, axis=0)), np.exp(np.nanmax(share, axis=0))
        cells = " | ".join(f"{m:.3f}, {w:.2f}" for m, w in zip(mean, most, strict=True))
        print(f"| {known} | {slip} | {kind} | {len(share)} cases | {cells} |")


if __name__ == "__main__":
    main()
