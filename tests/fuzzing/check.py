"""Requirements for any damaged input: one line, or a drive in which only the damaged values differ."""

import resource
import shutil
import signal
import struct
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import fields
from itertools import takewhile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from fuzzing.mutations import LARGEST, Draw, broken, crossed
from fuzzing.seeds import Seed
from sigmaswarm import read_drive, write_drive
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import SigmaswarmError, SigmaswarmWarning

SECONDS, MEGABYTES, CHARACTERS = 10, 1000, 1000
"""What an input may take at most, and the length of a line at most."""
REACH = 5
"""Samples that one record of a log can touch: in another table its neighbors are interpolated from it."""


class Hang(BaseException):
    """An input took too long; no Exception, so that no reader takes it for a broken file."""


class Finding(AssertionError):
    """What is promised does not hold."""


@contextmanager
def limited(seconds: int) -> Generator[None]:
    """Stop after so many seconds of this process's own: a busy machine is no failure."""

    def stop(*_: object) -> None:
        raise Hang(f"takes longer than {seconds} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def reset_peak() -> None:
    """Reset the peak memory of this process, where the system can (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_megabytes() -> float:
    """The most memory that this process had since `reset_peak`, or ever."""
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1000
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def memory_limit() -> float:
    """Megabytes that an input may bring the process to; resets the peak."""
    reset_peak()
    return peak_megabytes() + MEGABYTES


def copied(sound: Path, path: Path, folder: Path) -> Path:
    """A copy of a sound log, which is ``path`` below ``sound``."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound, folder)
    return folder / path.relative_to(sound)


def break_files(draw: Draw, seed: Seed, folder: Path) -> int | None:
    """Break one or two files in place; how many records differ, None where that can't be told."""
    files = sorted(f for f in folder.rglob("*") if f.is_file())
    touched: int | None = 0
    for file in draw(st.lists(st.sampled_from(files), min_size=1, max_size=2, unique=True)):
        before = file.read_bytes()
        crosses = len(files) > 1 and draw(st.integers(0, 19)) == 0
        if crosses:
            after = crossed(draw, before, draw(st.sampled_from(files)).read_bytes())[:LARGEST]
        else:
            after = broken(draw, file.name, seed.kind, before)[:LARGEST]
        file.write_bytes(after)
        whole = crosses or file.suffix == ".toml"
        count = None if whole else records_touched(seed.kind, before, after)
        touched = None if touched is None or count is None else touched + count
    return touched


def records_touched(kind: str, before: bytes, after: bytes) -> int | None:
    """How many lines, messages or numbers differ; None where all may hang on what differs."""
    if kind in ("text", "nmea", "ubx"):
        mark = b"\xb5\x62" if kind == "ubx" else b"\n"
        old, new = before.split(mark), after.split(mark)
        header = max(len([*takewhile(lambda line: line[:1] in b"#%", old)]), 1)
        if kind == "text" and old[:header] != new[:header]:
            return None
        if before.count(b'"') != after.count(b'"') or (kind == "nmea" and Counter(old) == Counter(new)):
            return None  # quotes join lines; a sentence belongs to the one before
        return _different(Counter(old), Counter(new))
    if kind == "npy":
        if len(before) != len(after) or before[:128] != after[:128]:
            return None
        return int(np.count_nonzero(np.frombuffer(before[128:], "V8") != np.frombuffer(after[128:], "V8")))
    if kind == "ulog":
        old, new = _ulog(before), _ulog(after)
        if [m for m in old if m[2:3] != b"D"] != [m for m in new if m[2:3] != b"D"]:
            return None  # definitions
        return _different(Counter(old), Counter(new))
    return None


def _different(old: Counter[bytes], new: Counter[bytes]) -> int:
    return (old - new).total() + (new - old).total()


def _ulog(data: bytes) -> list[bytes]:
    found, at = [], 16
    while at + 3 <= len(data):
        end = at + 3 + struct.unpack_from("<H", data, at)[0]
        found.append(data[at:end])
        at = end
    return found


def check(seed: Seed, path: Path, imu: Path, sound: Drive, touched: int | None, scratch: Path) -> bool:
    """Read a broken log; whether it gave a drive.

    Raises
    ------
    Finding
        A line is no line, a drive can't be read back, or samples differ that the faults did not touch.
    """
    most = memory_limit()
    with limited(SECONDS), warnings.catch_warnings():
        warnings.simplefilter("error")  # a line of NumPy's on stderr is not one of ours
        warnings.simplefilter("ignore", SigmaswarmWarning)
        shutil.rmtree(scratch, ignore_errors=True)
        again = None
        for read in (seed.look, seed.read):
            try:
                got = read(path, imu)
                again = write_drive(got, scratch) if isinstance(got, Drive) else None
            except SigmaswarmError as error:
                said = str(error)
                if not said.isprintable() or len(said) > CHARACTERS:
                    raise Finding(f"no line: {said[:200]!r}, {len(said)} characters") from None
                got = None
            except OSError:
                got = None  # the command line says which file it was
        if peak_megabytes() > most:
            raise Finding(f"more than {MEGABYTES} MB")
        if not isinstance(got, Drive) or again is None:
            return False
        require_same(got, read_drive(again))
    if touched is not None:
        differing(sound, got, REACH * touched)
    return True


def require_same(got: Drive, again: Drive) -> None:
    """Refuse a drive that reads back otherwise than it was."""
    for name in ("imu", "gps", "truth"):
        old, new = getattr(got, name), getattr(again, name)
        for field in fields(old) if old is not None else ():
            a, b = getattr(old, field.name), getattr(new, field.name)
            apart = field.name in ("x", "y") and name == "gps" and got.frame == "wgs84"  # computed again
            if not (np.allclose(a, b) if apart else np.array_equal(a, b)):
                raise Finding(f"{name}.{field.name} reads back otherwise")


def differing(sound: Drive, got: Drive, allowed: int) -> None:
    """Refuse more than ``allowed`` samples of a table to differ from, or to be missing beside, the sound one's."""
    for name in ("imu", "gps", "truth"):
        old, new = getattr(sound, name), getattr(got, name)
        if old is None or new is None:
            if old is not None and not allowed:
                raise Finding(f"{name} is gone")
            continue
        _, i, j = np.intersect1d(_clock(sound, old.time), _clock(got, new.time), return_indices=True)
        wrong = np.zeros(len(i), bool)
        for field in fields(old):
            a, b = getattr(old, field.name), getattr(new, field.name)
            if field.name != "time" and a is not None and b is not None:
                apart = np.abs(a[i] - b[j])
                apart = (
                    np.minimum(apart, np.abs(apart - 2 * np.pi))
                    if field.name in ("course", "theta")
                    else apart
                )
                wrong |= apart > 1e-5 * (1 + np.abs(a[i]))  # times in ns that come as floats lose 0.3 us
        if wrong.sum() > allowed or len(old) - len(i) > allowed:
            raise Finding(
                f"{name}: {wrong.sum()} samples differ and {len(old) - len(i)} are gone, {allowed} could be"
            )


def _clock(drive: Drive, time: np.ndarray) -> np.ndarray:
    """Tenths of a ms of the log's own clock."""
    zero = int(drive.metadata.get("time_origin_s", 0))
    return np.round(np.clip(time * 1e4, -9e17, 9e17)).astype(np.int64) + zero * 10_000


def signature(error: BaseException) -> str:
    """The kind of a finding: what was raised, and where in our code."""
    own = [f for f in traceback.extract_tb(error.__traceback__) if "/sigmaswarm/" in f.filename]
    where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""
    said = " ".join(str(error).split())[:100] if not own else ""
    return f"{type(error).__name__} {where}{said}"


def keep(folder: Path, source: Path, why: str) -> None:
    """Keep an input with what it does."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder / "in")
    (folder / "why.txt").write_text(f"{why}\n\n{traceback.format_exc()}")


def repeat(one: Callable[[st.DataObject], None], times: int, number: int) -> None:
    """Call a function with that many draws, which a seed determines."""
    run = settings(
        max_examples=times,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )(given(data=st.data())(one))
    seed(number)(run)()
