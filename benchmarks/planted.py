"""Measure the reliability of the doctor: planted faults, false alarms, repairs of clocks on short windows, mounting.

    python benchmarks/planted.py faults drives --simulated 20
    python benchmarks/planted.py mounting drives --simulated 40
    python benchmarks/planted.py windows drives --count 3000
    python benchmarks/planted.py windows drives --count 3000 --simulated 100 --clocks sound

faults: every fault of `tests/doctor/faults.py` is planted in each recording below a folder and in simulated drives. If
the clock of a recording has an offset, it is repaired first. windows: 60 s of a drive; the clock of the fixes has an
offset, a drift, jitter, all of these or none. If the diagnosis offers a repair, it is applied as in
`sigmaswarm.repair`. Forecasts of the next fix and of fixes 3 to 5 s ahead are compared before and after the repair,
with two filters without tuning: planar5 and tilted12. (The preset ``datasheet`` is not suitable: on these windows, its
forecasts of the next fix have errors of 2 to 80 m before and after.) mounting: each log with six axes is imported with
three wrong mountings, one of `WRONG` and two random ones; each of its windows of 60 s, with one of these. Prints
Markdown.
"""

import argparse
import sys
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sigmaswarm import (
    Diagnosis,
    Drive,
    FilterParameters,
    Gps,
    SigmaswarmError,
    diagnose,
    read_drive,
    repair,
    simulate,
)
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.mounting import angle_of, mounting_of, rotate_imu
from sigmaswarm.drives.mounting import with_rotation
from sigmaswarm.drives.split import clip
from sigmaswarm.filters.presets import DEFAULTS, baseline
from sigmaswarm.filters.run import run_innovations
from sigmaswarm.geodesy import rotation_of
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.simulation import IMU_GRADES

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from doctor.faults import FAULTS, MORE, THIRD_AXES, codes_of

GPS = ("white-1m", "ublox-m8", "f9p-rtk")
JUDGES = {
    "planar5": DEFAULTS,
    "tilted12": FilterParameters(
        *(0.1, 2.0, 0.0, (1.0,) * 12, (1.0,) * 2),
        **{
            "model": "tilted12",
            "kind": "ekf",
            "lateral_noise": 1.0,
            "standstill_noise": 1.0,
            "robust_dof": 4.0,
        },
    ),
}
"""Models and options of the filters (without tuning) with which repairs of clocks are evaluated."""
CLOCKS = ["sound", "offset", "drift", "jitter", "all"]
LONGEST = 180.0
"""Length (s) of the used part in the middle of a recording."""
WRONG = [(180, 0, 0), (0, 180, 0), (0, 0, 180), (90, 0, 0), (0, 90, 0), (0, 0, 90), (60, 0, 0), (0, -60, 30)]
"""Roll, pitch and yaw, deg, of wrong mountings."""
LENGTH = 60.0
"""Length of a window, s."""


def sound_drives(folder: Path, simulated: int, first: int = 0, longest: float = LONGEST) -> Iterator[Drive]:
    """Yield recordings below a folder, except "as recorded" drives with faults, and simulated drives of all IMU grades.

    ``first`` is the number of the first simulated drive; of a recording only the middle ``longest`` s are used.
    """
    for about in sorted(folder.glob("*/drive.toml")):
        if not about.parent.name.endswith("as-recorded"):
            drive = read_drive(about.parent)
            middle = float(drive.imu.time[0] + drive.imu.time[-1]) / 2
            yield clip(drive, middle - longest / 2, middle + longest / 2)
    grades = [name for name in IMU_GRADES if name not in ("ideal", "carla")]
    for run in range(first, first + simulated):
        yield simulate(
            "urban", run=run, imu=grades[run % len(grades)], gps=GPS[run % len(GPS)], duration=120.0,
            terrain=("flat", "hilly")[run // 2 % 2], vibration=float(run % 3 > 0),
        )  # fmt: skip


def faults(drives: Iterator[Drive]) -> None:
    """Print a row for each fault: drives on which it is found, reported as not observable, or missed."""
    named = Counter[str]()
    told, missed = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    alarms, count = [], 0
    for drive in drives:
        count += 1
        sound = diagnose(drive)
        # an offset of the recording itself
        if any(f.code == "clock-offset" and f.repair for f in sound.findings):
            drive = repair(drive, sound, only=["clock-offset"])
            sound = diagnose(drive)
        alarms += [f"{drive.name}: {f.code}" for f in sound.findings if f.severity == "serious"]
        six = drive.imu.az is not None and drive.imu.gx is not None
        for fault, (plant, _) in {**FAULTS, **MORE, **(THIRD_AXES if six else {})}.items():
            found = diagnose(plant(drive))
            each = {**THIRD_AXES, **FAULTS, **MORE}[fault][1]  # signs of single axes may describe a rotation
            if codes_of(fault, drive) <= found.codes or each <= found.codes:
                named[fault] += 1
            elif hidden(fault, sound, found):
                told[fault].append(drive.name)
            else:
                missed[fault].append(drive.name)
        print(drive.name, named.total(), dict(told), dict(missed), alarms, file=sys.stderr, flush=True)
    print("| planted | found | reported as not observable | missed on |\n|---|---|---|---|")
    for fault in {**named, **told, **missed}:
        print(f"| {fault} | {named[fault]} | {', '.join(told[fault])} | {', '.join(missed[fault])} |")
    unseen, lost = (sum(map(len, some.values())) for some in (told, missed))
    whole = named.total() + unseen + lost
    print(f"\n{named.total()} of {whole} found ({named.total() / whole:.1%}), {unseen} reported as not")
    print(
        f"observable, {lost} missed; serious findings on the {count} sound drives: {', '.join(alarms) or 'none'}"
    )


def hidden(fault: str, sound: Diagnosis, sick: Diagnosis) -> bool:
    """Return True if the doctor reports that such a fault is not observable, or that the values can't be checked."""
    if "s late" in fault or "s early" in fault:
        visible = sound.visible_clock_offset
        return visible is None or visible > float(fault.split()[0])
    if "stated" in fault:
        return "gps-correlated" in sick.codes  # the size of correlated errors is not observable
    return bool({c for c in sound.codes if c.startswith("unseen-") and c != "unseen-clock"})


def windows(drives: list[Drive], count: int, clocks: list[str], seed: int) -> None:
    """Print, by kind of clock, numbers of windows with a serious finding or a repair, and the effect on forecasts."""
    rng, table = np.random.default_rng(seed), defaultdict[str, Counter[str]](Counter)
    alarms = []
    for number in range(count):
        drive = drives[number % len(drives)]
        first = drive.imu.time[0] + rng.uniform(0, max(drive.duration - LENGTH, 0.0))
        kind = clocks[number // len(drives) % len(clocks)]
        offset = float(rng.choice([rng.uniform(-1, 1), 18.0])) * (kind in ("offset", "all"))
        try:
            window = clip(drive, first, first + LENGTH)
            sick = with_clock(window, offset, rng.uniform(-3e-3, 3e-3) * (kind in ("drift", "all")),
                              rng.uniform(0, 0.05) * (kind in ("jitter", "all")), rng)  # fmt: skip
            found = diagnose(sick)
        except SigmaswarmError:
            continue
        seen = table[kind]
        seen["windows"] += 1
        clock = [f for f in found.findings if f.code == "clock-offset"]
        if kind == "sound":
            alarms += [
                f"{drive.name} from {first:.0f} s: {f.code}"
                for f in found.findings
                if f.severity == "serious"
            ]
        seen["serious"] += any(f.severity == "serious" for f in clock)
        if any(f.repair for f in clock):
            judge(sick, found, offset, seen)
        if number % 50 == 49:
            print(number + 1, {k: dict(v) for k, v in table.items()}, alarms, file=sys.stderr, flush=True)
    heads = (
        "windows",
        "serious",
        "repairs offered",
        "applied",
        "within 0.15 s",
        *(f"{name} {head}" for name in JUDGES for head in ("worse by 5%", "worst")),
    )
    print(f"| clock | {' | '.join(heads)} |\n|---|{'---|' * len(heads)}")
    for kind, seen in table.items():
        print(f"| {kind} | {' | '.join(str(seen[head]) for head in heads)} |")
    print(f"\nserious findings of any kind on sound windows: {', '.join(alarms) or 'none'}")


def judge(sick: Drive, found: Diagnosis, offset: float, seen: Counter[str]) -> None:
    """Apply the repair, compare forecasts before and after it, and update the counts in ``seen``."""
    seen["repairs offered"] += 1
    mended = repair(sick, found)
    moved = float(np.median(mended.gps.time - sick.gps.time)) if len(mended.gps) == len(sick.gps) else 0.0
    if moved == 0.0:
        return
    seen["applied"] += 1
    seen["within 0.15 s"] += abs(moved + offset) < 0.15
    for name, like in JUDGES.items():
        before, after = (forecasts(drive, baseline(sick, like)) for drive in (sick, mended))
        if before is not None and after is not None:
            ratio = float(np.max(after / before))
            seen[f"{name} worse by 5%"] += ratio > 1.05
            seen[f"{name} worst"] = max(seen[f"{name} worst"], round(ratio, 2))  # type: ignore[assignment]


def mountings(drives: Iterator[Drive]) -> None:
    """Print the errors of the mountings that the doctor finds, for whole drives and for windows."""
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    apart: list[float] = []
    mounts: list[float] = []
    for number, drive in enumerate(drives):
        if drive.imu.az is None or drive.imu.gx is None:
            continue
        cuts = np.arange(drive.imu.time[0], drive.imu.time[-1] - LENGTH + 1, LENGTH)
        pieces = {"whole": [drive], "60 s": [clip(drive, cut, cut + LENGTH) for cut in cuts]}
        for what, some in pieces.items():
            for piece in some:
                course = gather(piece).course
                own = course and mounting_of(piece, course)
                for seed in range(3) if what == "whole" else [number % 3]:
                    rotation = Rotation.random(random_state=1000 * number + seed).as_matrix()
                    if seed == 2:
                        rotation = rotation_of(*WRONG[number % len(WRONG)])
                    about = with_rotation(piece.metadata, rotation)
                    wrong = replace(piece, imu=rotate_imu(piece.imu, rotation), metadata=about)
                    found = course and mounting_of(wrong, course)
                    if not found or not own:
                        errors[what, "none"].append(np.nan)
                        continue
                    errors[what, found.confidence].append(np.degrees(angle_of(found.rotation @ rotation)))
                    if found.confidence != "no":
                        off = found.rotation @ rotation @ own.rotation.T
                        apart.append(float(np.degrees(angle_of(off))))
                        mounts.append(float(np.degrees(angle_of(found.mount @ own.mount.T))))
        print(
            drive.name, {k: np.round(v, 1).tolist() for k, v in errors.items()}, file=sys.stderr, flush=True
        )
    print("| log | confidence | count | median, deg | 90% | 95% | largest |\n|---|---|---|---|---|---|---|")
    for (what, confidence), each in sorted(errors.items(), reverse=True):
        quantiles = np.quantile(each, [0.5, 0.9, 0.95, 1.0])
        print(f"| {what} | {confidence} | {len(each)} | {' | '.join(f'{q:.1f}' for q in quantiles)} |")
    print(f"\nestimate for the rotated log minus rotated estimate: at most {np.max(apart):.2g} deg")
    print(
        f"difference of the reported mountings of the original and the rotated log: at most {np.max(mounts):.2g} deg"
    )


def with_clock(drive: Drive, offset: float, drift: float, jitter: float, rng: np.random.Generator) -> Drive:
    """Return the drive with fixes on another clock: offset (s), drift (s/s) and standard deviation of each time (s)."""
    time = drive.gps.time
    wrong = time + offset + drift * (time - np.mean(time)) + jitter * rng.standard_normal(len(time))
    order = np.argsort(wrong, kind="stable")
    columns = {name: None if v is None else v[order] for name, v in vars(drive.gps).items()}
    columns["time"] = np.maximum.accumulate(wrong[order]) + 1e-6 * np.arange(len(time))
    return replace(drive, gps=Gps(**columns))


def forecasts(drive: Drive, parameters: FilterParameters) -> np.ndarray | None:
    """Return RMS errors (m) of forecasts of the next fix and of fixes hidden for 3 to 5 s; None without a start."""
    try:
        size = np.sort(np.hypot(*run_innovations(drive, parameters).innovation.T))
        hidden_fixes = (
            BatchScorer.prepare([drive], PassOptions(forecasts=True)).scores([parameters]).forecast_rmse[0, 0]
        )
    except SigmaswarmError:
        return None
    found = np.array([np.sqrt(np.mean(size[: max(int(0.95 * len(size)), 1)] ** 2)), hidden_fixes])
    return found if np.isfinite(found).all() else None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["faults", "windows", "mounting"])
    parser.add_argument("drives", type=Path)
    parser.add_argument("--simulated", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0, help="seed of the windows")
    parser.add_argument(
        "--clocks", nargs="+", choices=CLOCKS, default=CLOCKS, help="kinds of clocks of the windows"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    longest = np.inf if options.what == "windows" else LONGEST
    drives = sound_drives(options.drives, options.simulated, options.first, longest)
    if options.what == "faults":
        faults(drives)
    elif options.what == "mounting":
        mountings(drives)
    else:
        windows(list(drives), options.count, options.clocks, options.seed)


if __name__ == "__main__":
    main()
