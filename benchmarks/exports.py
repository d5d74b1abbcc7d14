"""Compare exported filters with the library, and measure the time and size of the C filters.

    python benchmarks/exports.py ../shared/drives [--quick]

The C library in double and float, and the FilterPy script, run over whole drives. For comparison, a twin also runs: the
library with an initial heading that differs by 1e-13 rad. A difference is the largest in a run, over all states,
relative to max(1, |x_i|). Prints Markdown tables. --quick omits FilterPy, which takes most of the time.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from exported import OPTIMIZED, build, distance, replay, run_script, tuned, twin
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, read_drive, simulate
from sigmaswarm.filters.models import MODELS

KINDS = ("ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf")
REAL = ("kitti-09-30-0033", "colorado-1", "dresden")
TIMER = r"""
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "ins_gps.h"
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
int main(void)
{
    static InsGps f;
    const ins_gps_real mean[5] = {0, 0, 10, 0, 0};
    const ins_gps_real P[25] = {1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1};
    const double dt = @DT@;
    double best[2] = {1.0, 1.0};
    for (int fixes = 0; fixes < 2; fixes++) {
        for (int trial = 0; trial < 7; trial++) {
            ins_gps_init(&f, 0.0, mean, P, 0);
            const double start = now();
            for (int k = 1; k <= 20000; k++) {
                const double t = k * dt;
                if (fixes) {
                    ins_gps_update(&f, t, (ins_gps_real)(10.0 * t), 0, 0);
                }
                ins_gps_predict(&f, t, (ins_gps_real)(k % 7 - 3), (ins_gps_real)(k % 5 - 2),
                                @MORE@(ins_gps_real)(k % 3 - 1));
            }
            const double each = (now() - start) / 20000;
            best[fixes] = each < best[fixes] ? each : best[fixes];
        }
    }
    printf("%.0f %.0f %zu\n", 1e9 * best[0], 1e9 * (best[1] - best[0]), sizeof f);
    return 0;
}
"""


def drives(folder: Path) -> list[Drive]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SigmaswarmWarning)
        return [
            simulate("urban", duration=60.0, gps="white-1m"),
            *(read_drive(folder / name) for name in REAL),
        ]


def parity(drive: Drive, p: FilterParameters, folder: Path, *, quick: bool) -> list[float]:
    """Return the largest differences from the library: twin, C in double, script, position of C in float (m)."""
    ours, of_twin = twin(drive, p)
    double = distance(replay(build(folder, p), drive, p.model).mean, ours)
    single = replay(build(folder, p, "-DINS_GPS_FLOAT"), drive, p.model).mean
    metres = float(np.max(np.hypot(*(single[:, :2] - ours[:, :2]).T)))
    script = np.nan if quick or p.model == "tilted12" else distance(run_script(folder, p, drive).mean, ours)
    return [of_twin, double, script, metres]


def cost(p: FilterParameters, folder: Path, *flags: str) -> list[int]:
    """Return the time per predict and per update, ns, and the sizes of state and code, bytes."""
    more = "(ins_gps_real)9.8, (ins_gps_real)0.01, (ins_gps_real)0.02, " if p.model == "tilted12" else ""
    main = TIMER.replace("@DT@", repr(p.nominal_interval)).replace("@MORE@", more)
    program = build(folder, p, *OPTIMIZED, *flags, main=main)
    ns_predict, ns_update, state = map(int, subprocess.check_output([program], text=True).split())
    command = ["gcc", "-std=c99", "-Os", *flags, "-c", folder / "ins_gps.c", "-o", folder / "ins_gps.o"]
    subprocess.run(command, check=True)
    size = subprocess.check_output(["size", folder / "ins_gps.o"], text=True)
    return [ns_predict, ns_update, state, int(re.findall(r"\d+", size)[0])]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("drives", type=Path)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    print("| drive | model | filter | twin | C, double | FilterPy script | C, float: position |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for drive in drives(arguments.drives):
            for model in MODELS if drive.imu.az is not None else ("planar5", "planar8"):
                for kind in (kind for kind in KINDS if kind in MODELS[model].filter_types):
                    p = tuned(model, kind, drive.nominal_interval)
                    folder = Path(name) / f"{drive.name}-{model}-{kind}"
                    twin_, double, script, metres = parity(drive, p, folder, quick=arguments.quick)
                    cells = f"{twin_:.0e} | {double:.0e} | {script:.0e} | {metres:.1e} m"
                    print(f"| {drive.name} | {model} | {kind} | {cells} |", flush=True)
        print("\n| filter | real | history | predict | update | state | code (-Os) |")
        print("|---|---|---|---|---|---|---|")
        for model, kind, everything in (
            ("planar5", "ukf", False),
            ("planar5", "ekf", False),
            ("planar8", "ukf", False),
            ("planar8", "ukf", True),
            ("planar8", "adaptive-ukf", True),
            ("tilted12", "ekf", False),
            ("tilted12", "ekf", True),
        ):
            for flags in ((), ("-DINS_GPS_HISTORY=0",), ("-DINS_GPS_HISTORY=0", "-DINS_GPS_FLOAT")):
                p = tuned(model, kind, 0.01, everything=everything)
                ns_predict, ns_update, state, code = cost(p, Path(name) / "cost", *flags)
                label = f"{model} {kind}" + (", all options" if everything else "")
                real = "float" if "-DINS_GPS_FLOAT" in flags else "double"
                history = "none" if flags else "1 s at 100 Hz"
                print(
                    f"| {label} | {real} | {history} | {ns_predict} ns | {ns_update} ns | {state} B | {code} B |"
                )


if __name__ == "__main__":
    main()
