"""Test kills at random times, and full disks: ``python -m fuzzing.kills --count 200``, which is run manually.

Every command that writes files is killed at random times, with older results at the place of its output. Then there
must be no incomplete file under a final name, no older file may be missing, and the same command, run again, must give
the bytes of an undisturbed run. The same is tested with a disk that becomes full, if the system allows mounting a small
one.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sigmaswarm.drives.writer import write_drive
from sigmaswarm.simulation import simulate

PROGRAM = "from sigmaswarm.cli import main; main()"
SEARCH = ("--particles", "8", "--generations", "12")
Tree = dict[str, bytes]


@dataclass(frozen=True)
class Command:
    """A command that fills ``out``.

    Attributes
    ----------
    words : of the command line
    resumes : whether it goes on with ``--resume``; other commands are just started again
    old : what stands in the place of its results before: "results" of other bytes, another "drive", or nothing
    before : words of a command that makes what it needs
    """

    words: tuple[str, ...]
    resumes: bool = False
    old: str = "results"
    before: tuple[str, ...] = ()
    ok: tuple[int, ...] = (0,)


COMMANDS = {
    "tune": Command(("tune", "drives/a", "--out", "out/t", *SEARCH, "--trials", "2"), True, ""),
    "compare": Command(
        ("compare", "drives/a", "--out", "out/c", *SEARCH, "--optimizers", "pso", "de", "--seeds", "2"),
        True,
        "",
    ),
    "study": Command(
        ("study", "--out", "out/s", "--runs", "1", "--trials", "2", "--particles", "4", "--generations", "4"),
        True,
        "",
    ),
    "simulate": Command(
        ("simulate", "--out", "out/d", "--maneuver", "brake", "turns", "--runs", "2"), True, ""
    ),
    "import": Command(
        ("import", "imu.csv", "--gps", "gps.csv", "--out", "out/d", "--overwrite"), old="drive"
    ),
    "run": Command(("run", "tuned", "drives/b", "--out", "out/e.csv")),
    "evaluate": Command(("evaluate", "tuned", "drives/b", "--out", "out/e", "--overwrite")),
    "export": Command(("export", "tuned", "--to", "c99", "--out", "out/x")),
    "report": Command(
        ("report", "evaluated", "--out", "out/page.html"),
        before=("evaluate", "tuned", "drives/b", "--out", "evaluated"),
    ),
    "doctor": Command(("doctor", "drives/sick", "--fix", "out/mended"), old="", ok=(0, 1)),
}


@dataclass
class Outcome:
    """What kills of one command have shown."""

    tried: int = 0
    hit: int = 0
    findings: Counter[str] = field(default_factory=Counter[str])


def tree(folder: Path) -> Tree:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def visible(files: Tree) -> Tree:
    kept = ".sigmaswarm-result.json"
    return {k: v for k, v in files.items() if not any(p.startswith(".") and p != kept for p in Path(k).parts)}


def prepare(place: Path) -> None:
    """What all commands work on."""
    for name, run in (("a", 0), ("b", 1)):
        write_drive(simulate("urban", run=run, duration=40.0, gps="white-1m"), place / "drives" / name)
    for file in ("imu.csv", "gps.csv"):
        shutil.copy(place / "drives" / "a" / file, place / file)
    shutil.copytree(place / "drives" / "a", place / "drives" / "sick")
    rows = [line.split(",") for line in (place / "drives/sick/imu.csv").read_text().splitlines()]
    turned = [[*row[:-1], row[-1] if i == 0 else repr(-float(row[-1]))] for i, row in enumerate(rows)]  # gz
    (place / "drives/sick/imu.csv").write_text("\n".join(",".join(row) for row in turned) + "\n")
    ended = call(place, ("tune", "drives/a", "--out", "tuned", *SEARCH))
    assert ended.returncode == 0, ended.stderr


def call(place: Path, words: tuple[str, ...]) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", PROGRAM, *words]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)


def reference(place: Path, command: Command) -> tuple[Tree, frozenset[str], float]:
    """What a run leaves that nobody disturbs; the files that differ between two such runs; how long it takes."""
    found: list[Tree] = []
    seconds = 0.0
    for _ in range(3):  # the first one compiles
        shutil.rmtree(place / "out", ignore_errors=True)
        (place / "out").mkdir()
        begin = time.monotonic()
        ended = call(place, command.words)
        seconds = time.monotonic() - begin
        assert ended.returncode in command.ok, ended.stderr
        found.append(tree(place / "out"))
    differing = frozenset(file for file in found[1] if found[1][file] != found[2].get(file))
    return found[2], differing, seconds


def lay_old(place: Path, command: Command, found: Tree) -> Tree:
    """Something older in the place of what the command is going to write."""
    shutil.rmtree(place / "out", ignore_errors=True)
    (place / "out").mkdir()
    if command.old == "drive":
        shutil.copytree(place / "drives" / "b", place / "out" / "d")
    elif command.old:
        for file in found:
            (place / "out" / file).parent.mkdir(parents=True, exist_ok=True)
            content = (
                found[file] if file.endswith(".sigmaswarm-result.json") else b"old"
            )  # which lists its files
            (place / "out" / file).write_bytes(content)
    return tree(place / "out")


def judge(place: Path, command: Command, old: Tree, found: Tree, loose: frozenset[str]) -> list[str]:
    """What is wrong with what an interrupted run left, and with what it becomes when it is started again."""
    wrong: list[str] = []
    left = visible(tree(place / "out"))
    replaced = command.old == "drive" and left == found  # a folder is replaced as one
    wrong += [f"{file} is gone" for file in old if file not in left and not replaced]
    for file, content in left.items():
        if file in found and file not in loose and content not in (old.get(file), found[file]):
            wrong.append(f"{file} is half-written, or of no run")
        if (
            file not in found
            and file not in old
            and not (command.resumes and Path(file).name.startswith("checkpoint-"))
        ):
            wrong.append(f"{file} is of no run")
    if left == found and not command.resumes and not command.old:
        return wrong  # it had ended, and refuses to write over its own result
    again = call(place, (*command.words, *(("--resume",) if command.resumes else ())))
    if again.returncode not in command.ok:
        return [*wrong, f"started again: {again.returncode}: {again.stderr.strip()[-200:]}"]
    last = tree(place / "out")
    wrong += [f"{file} missing at the end" for file in found if file not in last]
    wrong += [f"{file} left over at the end" for file in last if file not in found]
    wrong += [
        f"{k} differs at the end" for k in found if k not in loose and last.get(k, found[k]) != found[k]
    ]
    return wrong


def kills(place: Path, command: Command, count: int, rng: np.random.Generator) -> Outcome:
    """Kill a command at moments drawn over all of its time."""
    found, loose, seconds = reference(place, command)
    outcome = Outcome()
    for _ in range(count):
        old = lay_old(place, command, found)
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *command.words],
            cwd=place,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(rng.uniform(0.1, 1.0) * seconds)
        outcome.hit += process.poll() is None
        process.kill()
        process.wait()
        outcome.tried += 1
        outcome.findings.update(judge(place, command, old, found, loose))
    return outcome


def full_disk(place: Path, command: Command, share: float) -> Outcome | None:
    """Give a command a disk for a share of what it writes; None where no disk can be mounted."""
    found, loose, _ = reference(place, command)
    old = lay_old(place, command, found)
    kept = place / "kept"
    shutil.rmtree(kept, ignore_errors=True)
    (place / "out").rename(kept)
    (place / "out").mkdir()
    pages = sum(-(-len(v) // 4096) for v in old.values()) + share * sum(
        -(-len(v) // 4096) for v in found.values()
    )
    size = int(4096 * (pages + 3))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place / "out")]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        return None
    outcome = Outcome(tried=1)
    try:
        shutil.copytree(kept, place / "out", dirs_exist_ok=True)
        ended = call(place, command.words)
        outcome.hit = int(ended.returncode == 2)
        told = [line for line in ended.stderr.splitlines() if line.startswith("sigmaswarm: ")]
        if ended.returncode not in (2, *command.ok) or (ended.returncode == 2 and len(told) != 1):
            outcome.findings[f"ended with {ended.returncode}: {ended.stderr.strip()[-300:]}"] += 1
        if outcome.hit:
            subprocess.run(["mount", "-o", "remount,size=100m", str(place / "out")], check=True)
            outcome.findings.update(judge(place, command, old, found, loose))
    finally:
        subprocess.run(["umount", "-l", str(place / "out")], check=True)
    return outcome


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzzing.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=200, help="kills in all, over all commands")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--command", choices=COMMANDS, action="append", help="this one alone; may be repeated"
    )
    options = parser.parse_args()
    names, failed = options.command or list(COMMANDS), 0
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        prepare(place)
        for number, name in enumerate(names):
            command = COMMANDS[name]
            if command.before:
                assert call(place, command.before).returncode == 0
            outcome = kills(
                place, command, -(-options.count // len(names)), np.random.default_rng([options.seed, number])
            )
            failed += report(f"{name}, killed", outcome)
            for share in (0.02, 0.5, 0.9):
                disk = full_disk(place, command, share)
                if disk is not None:
                    failed += report(f"{name}, disk for {share:.0%}", disk)
    return 1 if failed else 0


def report(what: str, outcome: Outcome) -> int:
    """Print an outcome; how many findings it has."""
    print(
        f"{what:24} {outcome.tried:4} tried, {outcome.hit:4} hit, {outcome.findings.total()} findings",
        flush=True,
    )
    for kind, count in outcome.findings.items():
        print(f"    {count:4} x {kind}", flush=True)
    return outcome.findings.total()


if __name__ == "__main__":
    sys.exit(main())
