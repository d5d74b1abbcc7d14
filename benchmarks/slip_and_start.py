"""Tire slip and the start that is dated back: what each is worth, alone and together.

    python benchmarks/slip_and_start.py ../shared/drives --out slip.jsonl
    python benchmarks/slip_and_start.py ../shared/drives --out slip.jsonl --table

The cases are the 13 held-out ones of `defaults.py`. Every tuning is by default, with truth (T) and without (B), from
the alignments' starts, with `tire_slip` searched and with 0. Each is tested from the alignment's start and from
`dated_back`. Each tuning and each row of scores is a line of the file, and is not repeated. Prints Markdown: medians
over the seeds; then their geometric mean over the cases, relative to the default, and the largest ratio of a case.
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

import numpy as np

from defaults import cached, cases, stranger
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.dating_back import dated_back
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.drifts import Outages
from sigmaswarm.scoring.score import HEADING_COUNTS_ABOVE
from sigmaswarm.tuning.defaults import default_filter_options
from switches import quantities

MORE: dict[str, tuple[str, ...]] = {"no slip": (), "slip": ("slip",)}
"""Options in addition to the default ones."""
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
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    if not options.table:
        with ThreadPoolExecutor() as pool:
            parts = {name: of for name, of in cases(options.drives).items() if not stranger(name)}
            for seed, name, known, slip in product(range(options.seeds), parts, "TB", MORE):
                score(options.out, (name, *cached(name, parts[name])), known, slip, seed, pool)
    table(lines(options.out))


def score(out: Path, case: Any, known: str, slip: str, seed: int, pool: ThreadPoolExecutor) -> None:
    """Tune, or read the tuning, and score it."""
    name, training, test = case
    done = lines(out)
    key = (name, known, slip, seed)
    if (*key, "tuning") not in done:
        drives = training if known == "T" else [replace(drive, truth=None) for drive in training]
        chosen, _ = default_filter_options({}, [*drives, *test])
        use = (*chosen["use"], *MORE[slip])
        tuned = tune(drives, seed=seed, executor=pool, model=chosen["model"], use=use).parameters
        note(out, (*key, "tuning"), tuned.to_dict())
    else:
        tuned = FilterParameters(**done[*key, "tuning"])
    if (*key, "window") not in done:
        note(out, (*key, "window"), figures([PreparedDrive(drive) for drive in test], tuned))
    if (*key, "dated back") not in done:
        starts = [dated_back(drive, tuned) for drive in test]
        ready = [PreparedDrive(drive, start) for drive, start in zip(test, starts, strict=True)]
        note(out, (*key, "dated back"), figures(ready, tuned))


def figures(test: Sequence[PreparedDrive], parameters: FilterParameters) -> list[float]:
    """Scores in the order of `COLUMNS`, over all test drives together."""
    off, turned = zip(*(errors(one.drive, run_filter(one, parameters)) for one in test), strict=True)
    after, faced = zip(*(errors(one.drive, smooth(one, parameters)) for one in test), strict=True)
    found = BatchScorer(test, outages=False).scores([parameters])
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
    """Position errors, m, and heading errors where they count, rad, at the truth's times."""
    truth = drive.truth
    assert truth is not None
    scored = truth.select((truth.time >= estimate.time[0]) & (truth.time <= estimate.time[-1]))
    x, y = (np.interp(scored.time, estimate.time, estimate.mean[:, i]) for i in (0, 1))
    theta = np.interp(scored.time, estimate.time, np.unwrap(estimate.mean[:, 4]))
    counts = np.hypot(scored.vx, scored.vy) > HEADING_COUNTS_ABOVE
    return np.hypot(x - scored.x, y - scored.y), wrap_angle(theta - scored.theta)[counts]


def drift(test: Sequence[PreparedDrive], parameters: FilterParameters, length: float) -> float:
    """RMS over the drives and all placements of outages of a length, m."""
    each = []
    for one in test:
        outages = Outages(one, length=length, seed=0)
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
    """Medians over the seeds, and their ratios to the default."""
    rows: dict[tuple[str, ...], list[list[float]]] = {}
    for (name, known, slip, _, what), value in done.items():
        if what != "tuning":
            rows.setdefault((known, slip, what, name), []).append(value)
    median = {key: np.median(np.array(each), axis=0) for key, each in rows.items()}
    print("| truth | tuning | start | tested on | " + " | ".join(COLUMNS) + " |")
    print("|---" * (len(COLUMNS) + 4) + "|")
    for key, row in sorted(median.items()):
        print("| " + " | ".join(key) + " | " + " | ".join(f"{v:.3f}" for v in row) + " |")
    for known, slip, what in dict.fromkeys(key[:3] for key in median):
        share = [
            row / median[known, "no slip", "window", name]
            for (*which, name), row in median.items()
            if which == [known, slip, what]
        ]
        mean, most = np.exp(np.nanmean(np.log(share), axis=0)), np.nanmax(share, axis=0)
        cells = " | ".join(f"{m:.3f}, {w:.2f}" for m, w in zip(mean, most, strict=True))
        print(f"| {known} | {slip} | {what} | {len(share)} cases | {cells} |")


if __name__ == "__main__":
    main()
