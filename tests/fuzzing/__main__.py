"""Long run of the fuzzer: ``python -m fuzzing --minutes 30``. Prints the number of inputs, and saves failures."""

import argparse
import multiprocessing
import resource
import shutil
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from fuzzing.check import (
    MEGABYTES,
    SECONDS,
    break_files,
    check,
    copied,
    keep,
    peak_megabytes,
    repeat,
    signature,
)
from fuzzing.seeds import SEEDS
from importing.test_datasets import imu_csv

BATCH = 20
"""Inputs of one run of hypothesis; the clock is looked at in between."""
NEAR = 0.5
"""Share of a limit from which the input that comes nearest to it is kept, as ``slowest`` or ``largest``."""


def fuzz(name: str, seconds: float, number: int, found: Path) -> dict[str, object]:
    """Break one reader's log for some time; each kind of finding is kept once, as a folder.

    The input of the moment is in the folder ``last``, for the case that the process dies of it.
    """
    about, begin = SEEDS[name], time.monotonic()
    counts: dict[str, int] = {}
    tried = accepted = 0
    slowest = most = 0.0
    last = found / name / "last"
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        root = Path(place)
        (root / "sound").mkdir()
        imu, path = imu_csv(root), about.write(root / "sound")
        drive = about.read(path, imu)

        def one(data: st.DataObject) -> None:
            nonlocal tried, accepted, slowest, most
            copy = copied(root / "sound", path, last)
            touched = break_files(data.draw, about, last)
            tried, start = tried + 1, time.process_time()
            try:
                accepted += check(about, copy, imu, drive, touched, root / "out")
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                kind = signature(error)
                counts[kind] = counts.get(kind, 0) + 1
                if counts[kind] == 1:
                    keep(found / name / f"{number}-{len(counts)}", last, kind)
            took, peak = time.process_time() - start, peak_megabytes()
            if took > max(slowest, NEAR * SECONDS):
                keep(found / name / "slowest", last, f"{took:.1f} s")
            if peak > max(most, NEAR * MEGABYTES):
                keep(found / name / "largest", last, f"{peak:.0f} MB")
            slowest, most = max(slowest, took), max(most, peak)

        batch = 0
        while time.monotonic() - begin < seconds:
            repeat(one, BATCH, number * 100_000 + batch)
            batch += 1
    shutil.rmtree(last, ignore_errors=True)
    return {
        "reader": name,
        "tried": tried,
        "accepted": accepted,
        "slowest_s": round(slowest, 2),
        "peak_mb": round(most),
        "findings": counts,
    }


def fuzz_in_child(*arguments: Any) -> tuple[dict[str, Any] | None, int | None]:
    """Call `fuzz` in a process of its own, whose crash and peak memory are its own; its answer and its exit code."""
    fork = multiprocessing.get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        sender.send(fuzz(*arguments))

    child = fork.Process(target=work)
    child.start()
    sender.close()
    try:
        answer = receiver.recv()
    except EOFError:
        answer = None
    child.join()
    return answer, child.exitcode


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzzing", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="in all, over all readers")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--found", type=Path, default=Path("fuzz-found"), help="folder for what is found")
    parser.add_argument("--reader", choices=SEEDS, nargs="+", default=list(SEEDS), help="these alone")
    options = parser.parse_args()
    share = options.minutes * 60 / len(options.reader)
    print(f"seed {options.seed}, {share:.0f} s a reader, findings go to {options.found}/", flush=True)
    failed = total = 0
    for name in options.reader:
        answer, code = fuzz_in_child(name, share, options.seed, options.found)
        if answer is None:
            failed += 1
            last, died = options.found / name / "last", options.found / name / f"{options.seed}-died"
            if last.is_dir():
                last.rename(died)
            print(f"{name}: died with {code} ({died})", flush=True)
            continue
        total += answer["tried"]
        failed += len(answer["findings"])
        print(
            f"{name:22} {answer['tried']:6} inputs, {answer['accepted']:6} read, slowest "
            f"{answer['slowest_s']:5.2f} s, peak {answer['peak_mb']:5} MB, {len(answer['findings'])} findings",
            flush=True,
        )
        for kind, count in answer["findings"].items():
            print(f"    {count:5} x {kind}", flush=True)
    print(f"{total} inputs, {failed} findings")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
