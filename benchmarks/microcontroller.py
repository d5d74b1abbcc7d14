"""Measure cost and accuracy of the exported C library on Cortex-M boards, which QEMU emulates.

    python benchmarks/microcontroller.py ../shared/drives [--quick]

Needs Debian's gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm. Prints Markdown tables: differences from
`run_filter` over whole drives, in float and double; instructions, flash, RAM and stack of each filter. "predict" is the
mean over samples without a fix, "predict + update" the mean over samples with a fix. --quick uses the first minutes of
each drive.
"""

import argparse
import re
import sys
import tempfile
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from exported import tuned
from microcontroller import COMPILER, M4F, M7, Machine, OnBoard, build_for, replay_on, run
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, clip, read_drive, simulate
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.filters.run import run_filter

REAL = ("kitti-09-30-0033", "colorado-1", "kingston-1")
NO_HISTORY, FLOAT = "-DINS_GPS_HISTORY=0", "-DINS_GPS_FLOAT"
CLOCKS = {M4F.name: 168e6, M7.name: 480e6}
FILTERS = {
    "planar5 ekf": ("planar5", "ekf", False),
    "planar5 ukf": ("planar5", "ukf", False),
    "planar8 ekf": ("planar8", "ekf", False),
    "planar8 ukf": ("planar8", "ukf", False),
    "planar8 ekf, every option": ("planar8", "ekf", True),
    "planar8 ukf, every option": ("planar8", "ukf", True),
    "planar8 ukf, every option and fix-error": ("planar8", "ukf", True),
    "tilted12 ekf, every option": ("tilted12", "ekf", True),
    "tilted12 ekf, every option and fix-error": ("tilted12", "ekf", True),
}
CLOSE = (
    "planar5 ukf",
    "planar8 ekf, every option",
    "planar8 ukf, every option",
    "tilted12 ekf, every option",
)
BUILDS = ((M4F, (FLOAT,)), (M7, (FLOAT,)), (M7, ()))


def given(name: str, drive: Drive) -> FilterParameters:
    model, kind, everything = FILTERS[name]
    p = tuned(model, kind, drive.nominal_interval, everything=everything)
    return replace(p, fix_error=0.3) if name.endswith("fix-error") else p


def drives(folder: Path, *, quick: bool) -> list[Drive]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SigmaswarmWarning)
        real = [read_drive(folder / name) for name in REAL]
        if quick:
            real = [clip(drive, 0.0, initial_state(drive).time - drive.imu.time[0] + 120.0) for drive in real]
        return [simulate("urban", duration=60.0, gps="white-1m"), *real]


def off(board: OnBoard, ours: np.ndarray) -> tuple[float, float, float]:
    """Return the largest differences: of a state, relative to max(1, |x|); of the position, m; of the heading, deg."""
    error = board.mean - ours
    error[:, 4] = (error[:, 4] + np.pi) % (2 * np.pi) - np.pi
    relative = np.max(np.abs(error) / np.maximum(1.0, np.abs(ours)))
    return (
        float(relative),
        float(np.max(np.hypot(error[:, 0], error[:, 1]))),
        float(np.degrees(np.abs(error[:, 4]).max())),
    )


def heading(*columns: str) -> None:
    """Print the heading of a table whose first two columns contain text."""
    print(f"\n| {' | '.join(columns)} |\n|---|---|" + "---:|" * (len(columns) - 2))


def closeness(all_drives: list[Drive], folder: Path) -> None:
    heading("drive", "filter", "M7, double: any state", "M7, float", "M4F, float")
    for drive in all_drives:
        for name in CLOSE:
            p = given(name, drive)
            if p.model == "tilted12" and drive.imu.az is None:
                continue
            ours = run_filter(drive, p, recover=False).mean
            cells: list[str] = []
            for machine, flags in ((M7, ()), (M7, (FLOAT,)), (M4F, (FLOAT,))):
                board = replay_on(machine, build_for(machine, folder, p, *flags), drive, p.model)
                relative, metres, degrees = off(board, ours)
                cells.append(f"{1e3 * metres:.2f} mm, {degrees:.4f} deg" if flags else f"{relative:.0e}")
            print(f"| {drive.name} | {name} | {' | '.join(cells)} |", flush=True)


def instructions(board: OnBoard) -> tuple[float, float, float]:
    """Return the instructions of a predict, of a predict with an update, and of a sample on average over the drive."""
    fixed, both = board.fixes > 0, board.predict + board.update
    return float(board.predict[~fixed].mean()), float(both[fixed].mean()), float(both.mean())


def size(path: Path) -> tuple[int, int]:
    """Return the sizes of code with constants, and of static data, bytes."""
    text, data, bss = run(["arm-none-eabi-size", path]).splitlines()[1].split()[:3]
    return int(text), int(data) + int(bss)


@cache
def _libraries(map_text: str) -> dict[str, int]:
    """Return the sizes (bytes) of libm and of libgcc's software double in a program, from the linker's map."""
    kept = map_text.split("Linker script and memory map")[1]
    sums = {"libm": 0, "libgcc": 0}
    for amount, file in re.findall(
        r"^ \.(?:text|rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+) (\S+)$", kept, re.M
    ):
        for library in sums:
            if f"{library}" in Path(file.split("(")[0]).stem:
                sums[library] += int(amount, 16)
    return sums


def state_bytes(machine: Machine, folder: Path, *flags: str) -> int:
    """Return sizeof(InsGps), bytes."""
    source = folder / "size.c"
    source.write_text('#include "ins_gps.h"\nInsGps filter;\n')
    run([COMPILER, *machine.flags, *flags, "-std=c99", "-c", source, "-o", folder / "size.o"])
    return size(folder / "size.o")[1]


def worst_stack(machine: Machine, folder: Path, *flags: str) -> int:
    """Return the largest sum of stack frames over the calls of the exported functions; frames of libm are unknown."""
    command = [COMPILER, *machine.flags, *flags, "-std=c99", "-O2", "-fcallgraph-info=su"]
    run([*command, "-c", folder / "ins_gps.c", "-o", folder / "su.o"])
    graph = (folder / "su.ci").read_text()
    frames = {
        name: int(frame)
        for name, frame in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes', graph)
    }
    calls = re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', graph)

    @cache
    def depth(name: str) -> int:
        return frames.get(name, 0) + max((depth(to) for source, to in calls if source == name), default=0)

    return max(depth(name) for name in frames)


def costs(drive: Drive, folder: Path) -> None:
    heading(
        *(
            "filter",
            "board",
            "predict",
            "predict + update",
            "mean sample",
            "code -O2",
            "code -Os",
            "libm",
            "libgcc",
        ),
        *("RAM", "stack: calls", "stack: seen"),
    )
    for name in FILTERS:
        p = given(name, drive)
        for machine, flags in BUILDS:
            program = build_for(machine, folder, p, NO_HISTORY, *flags)
            board = replay_on(machine, program, drive, p.model)
            code, _ = size(folder / "ins_gps.o")
            libraries = _libraries((folder / "program.map").read_text())
            small = ["-Os", "-std=c99", "-c", folder / "ins_gps.c", "-o", folder / "small.o"]
            run([COMPILER, *machine.flags, NO_HISTORY, *flags, *small])
            cells = [f"{count:.0f}" for count in instructions(board)]
            cells += [str(code), str(size(folder / "small.o")[0]), *map(str, libraries.values())]
            cells += [str(state_bytes(machine, folder, NO_HISTORY, *flags))]
            cells += [str(worst_stack(machine, folder, NO_HISTORY, *flags)), str(board.stack)]
            kind = f"{machine.name}, {'float' if flags else 'double'}"
            print(f"| {name} | {kind} | {' | '.join(cells)} |", flush=True)


def by_drive(all_drives: list[Drive], folder: Path) -> None:
    """Print instructions and calculated times of planar8 and tilted12 in float on the M4F, with and without options."""
    heading(
        *("drive, IMU", "filter", "predict: plain, every option", "ratio", "predict + update"),
        *("at 168 MHz (calculated)", "share of 10 ms"),
    )
    for drive in all_drives:
        for name in ("planar8 ukf, every option", "tilted12 ekf, every option"):
            p = given(name, drive)
            if p.model == "tilted12" and drive.imu.az is None:
                continue
            plain = tuned(p.model, p.kind, drive.nominal_interval, everything=False)
            got = [
                instructions(replay_on(M4F, build_for(M4F, folder, q, NO_HISTORY, FLOAT), drive, p.model))
                for q in (plain, p)
            ]
            (without, *_), (predict, both, _) = got
            times = [1e6 * both * cycles / CLOCKS[M4F.name] for cycles in (1.0, 1.5)]
            rate = f"{1 / drive.nominal_interval:.0f} Hz"
            print(
                f"| {drive.name}, {rate} | {name} | {without:.0f}, {predict:.0f} | "
                f"{predict / without:.2f} | {both:.0f} | {times[0]:.0f} to {times[1]:.0f} us "
                f"| {times[0] / 100:.1f} to {times[1] / 100:.1f} % |",
                flush=True,
            )


def lanes(drive: Drive, folder: Path) -> None:
    """Print the cost of the filters of a bank: planar8 and tilted12 in float on the M4F."""
    heading(
        *(
            "filter",
            "lanes",
            "predict",
            "predict + update",
            "state",
            "at 168 MHz (calculated)",
            "share of 10 ms",
        ),
        *("code -O2", "code -Os", "libm", "RAM", "stack"),
    )
    for name in ("planar8 ukf, every option", "tilted12 ekf, every option"):
        p = given(name, drive)
        for n in (1, 4, 8, 16):
            program = build_for(M4F, folder, p, NO_HISTORY, FLOAT, lanes=n)
            board = replay_on(M4F, program, drive, p.model)
            predict, both, _ = instructions(board)
            code, _ = size(folder / "ins_gps.o")
            libm = _libraries((folder / "program.map").read_text())["libm"]
            small = ["-Os", "-std=c99", "-c", folder / "ins_gps.c", "-o", folder / "small.o"]
            run([COMPILER, *M4F.flags, NO_HISTORY, FLOAT, *small])
            times = [1e6 * both * cycles / CLOCKS[M4F.name] for cycles in (1.0, 1.5)]
            stack = max(worst_stack(M4F, folder, NO_HISTORY, FLOAT), board.stack)
            print(
                f"| {name} | {n} | {predict:.0f} | {both:.0f} | {board.state.mean():.0f} | "
                f"{times[0]:.0f} to {times[1]:.0f} us | {times[0] / 100:.1f} to {times[1] / 100:.1f} % | {code} B | "
                f"{size(folder / 'small.o')[0]} B | {libm} B | {state_bytes(M4F, folder, NO_HISTORY, FLOAT)} B | "
                f"{stack} B |",
                flush=True,
            )


def soft_double(drive: Drive, folder: Path) -> None:
    """Print the cost of double on a board without hardware for it: the same filter in double on the M4F."""
    p = given("planar8 ukf, every option", drive)
    heading("drive", "planar8 ukf, every option, M4F", "predict", "predict + update", "mean sample")
    for label, flags in (("float, times in double", (FLOAT,)), ("double", ())):
        board = replay_on(M4F, build_for(M4F, folder, p, NO_HISTORY, *flags), drive, p.model)
        print(
            f"| {drive.name} | {label} | "
            + " | ".join(f"{count:.0f}" for count in instructions(board))
            + " |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("drives", type=Path)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    all_drives = drives(arguments.drives, quick=arguments.quick)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        closeness(all_drives, folder)
        by_drive(all_drives, folder)
        costs(all_drives[0], folder)
        soft_double(all_drives[0], folder)
        lanes(all_drives[0], folder)


if __name__ == "__main__":
    main()
