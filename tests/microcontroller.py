"""Build exported filters for Arm Cortex-M, and run them on boards that QEMU emulates.

In QEMU, each instruction takes a nanosecond (``-icount shift=0``), so the timer of a board counts instructions, 40 per
tick, and results are reproducible.
"""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from exported import write
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.c99 import replay_events
from sigmaswarm.exports.features import features_of
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters

COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
_MISSING = [tool for tool in (COMPILER, EMULATOR) if shutil.which(tool) is None]
needs_arm = pytest.mark.skipif(bool(_MISSING), reason=f"not installed: {', '.join(_MISSING)}")

BOARD = Path(__file__).parent / "arm"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
_START, _EVENT = 64, 8  # as in arm/replay.c
_EVENTS = {"imu": 0.0, "fix": 1.0, "odometer": 2.0}


@dataclass(frozen=True)
class Machine:
    """A board that QEMU emulates, and the flags to compile for it."""

    name: str
    flags: tuple[str, ...]


M4F = Machine("mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-mthumb"))
M7 = Machine("mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-mthumb"))


@dataclass(frozen=True)
class OnBoard:
    """Output of a board: times (k,) s, means (k, n), variances (k, n); and its cost.

    ``predict`` (k,) contains the instructions of each sample, ``update`` (k,) those of the calls since the previous
    sample, ``fixes`` (k,) the number of fixes among them, ``state`` (k,) the instructions to read the state;
    ``stack`` is in bytes.
    """

    time: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    predict: np.ndarray
    update: np.ndarray
    fixes: np.ndarray
    state: np.ndarray
    stack: int


def build_for(
    machine: Machine,
    folder: Path,
    parameters: FilterParameters,
    *flags: str,
    main: Path = BOARD / "replay.c",
    optimize: str = "-O2",
    lanes: int = 1,
) -> Path:
    """Build an exported filter with a program (``main``) for a board; the linker's map is ``program.map``."""
    write(folder, parameters, lanes=lanes)
    common = (
        *machine.flags,
        *has(parameters),
        *flags,
        optimize,
        "-ffunction-sections",
        "-fdata-sections",
        f"-I{folder}",
    )
    objects: list[Path] = []
    sources = [folder / "ins_gps.c", folder / "ins_gps_align.c"]
    for source in (*sources, main, BOARD / "board.c"):
        strict = WARNINGS if source in sources else ("-std=gnu99", "-fno-tree-loop-distribute-patterns")
        objects.append(folder / f"{source.stem}.o")
        run([COMPILER, *common, *strict, "-c", source, "-o", objects[-1]])
    program = folder / "program.elf"
    link = ("-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections", f"-Wl,-Map={folder / 'program.map'}")
    run([COMPILER, *common, *link, f"-T{BOARD / 'board.ld'}", *objects, "-lm", "-o", program])
    return program


def has(parameters: FilterParameters) -> list[str]:
    """Return the macros that select the additional arguments of the library's functions."""
    features = features_of(parameters)
    names = {"TILT": "tilted", "STD": "stated_std", "ODOMETER": "odometer"}
    return [f"-DHAS_{name}" for name, feature in names.items() if features[feature]]


def run(command: list[str | Path]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def emulate(machine: Machine, program: Path, *, timeout: float = 3600.0) -> int:
    """Run a program on a board, in the program's folder; return its exit code (99: trap)."""
    command = [EMULATOR, "-machine", machine.name, "-kernel", program, "-icount", "shift=0", "-nographic"]
    command += ["-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"]
    return subprocess.run(
        command, cwd=program.parent, stdin=subprocess.DEVNULL, timeout=timeout, check=False
    ).returncode


def replay_on(machine: Machine, program: Path, drive: Drive, model: ModelName = "planar5") -> OnBoard:
    """Run arm/replay.c over a drive."""
    (_, first), *told = replay_events(drive, model)
    start = np.zeros(_START)
    start[: len(first)] = first
    events = np.full((len(told), _EVENT), np.nan)
    for event, (name, numbers) in zip(events, told, strict=True):
        event[0] = _EVENTS[name]
        event[1 : 1 + len(numbers)] = numbers
    folder = program.parent
    (folder / "replay.bin").write_bytes(start.tobytes() + events.tobytes())
    code = emulate(machine, program)
    assert code == 0, f"the program ended with {code}"
    *numbers, stack = np.fromfile(folder / "estimate.bin")
    n = {"planar5": 5, "planar8": 8, "tilted12": 12}[model]
    table = np.array(numbers).reshape(-1, 2 * n + 5)
    time, mean, variance = table[:, 0], table[:, 1 : n + 1], table[:, n + 1 : 2 * n + 1]
    return OnBoard(time, mean, variance, *table[:, 2 * n + 1 :].T, int(stack))
