"""Killed commands and full disks: no incomplete file under its final name, and no loss of existing files."""

import errno
import os
import shutil
import subprocess
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

from processes import Process, run
from sigmaswarm import FilterParameters, evaluate, files, read_drive
from sigmaswarm.files import RESULT_FILE
from sigmaswarm.reports.evaluation import save_evaluation
from support import file_contents, no_pictures, quickly

COMMAND = """
from sigmaswarm.cli import main
from support import no_pictures
with no_pictures():  # the same bytes as in the tests' own process
    main()
"""
DYING = (
    """import os, signal, sys
sync, left = os.fsync, [int(sys.argv.pop(1))]
def dying(handle):
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    sync(handle)
os.fsync = dying
"""
    + COMMAND
)
COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", "{tuned}", "{drive}", "--out", "out/e.csv", "--overwrite"),
    "run-bag": ("run", "{tuned}", "{drive}", "--out", "out/e.ros2"),
    "evaluate": ("evaluate", "{tuned}", "{drive}", "--out", "out", "--overwrite"),
    "export": ("export", "{tuned}", "--to", "c99", "--out", "out"),
    "report": ("report", "evaluated", "--out", "out/page.html"),
    "simulate": ("simulate", "--out", "out", "--maneuver", "brake", "--environment", "clear", "--runs", "2",
                 "--workers", "1", "--resume"),
    "import": ("import", "imu.csv", "--gps", "gps.csv", "--out", "out/d", "--overwrite"),
}  # fmt: skip
FOLDERS = {"run-bag", "simulate"}
"""Commands that can't replace existing files."""


def hidden(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob(".*") if path.name != RESULT_FILE)


@pytest.fixture(scope="module")
def evaluated(drives: Path, tuned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an evaluation."""
    folder = tmp_path_factory.mktemp("evaluated") / "e"
    found = evaluate(read_drive(drives / "urban-clear-00"), FilterParameters.load(tuned))
    with no_pictures():
        save_evaluation(found, folder, tuned)
    return folder


@pytest.fixture
def arguments(evaluated: Path, drives: Path, tuned: Path, here: Path):
    """Return a function that gives a command's arguments, and creates a folder with its inputs."""

    def prepared(name: str) -> list[str]:
        drive = drives / "urban-clear-00"
        for file in ("imu.csv", "gps.csv"):
            shutil.copy(drive / file, file)
        if name == "report":
            shutil.copytree(evaluated, "evaluated")
        if name == "run-bag":
            pytest.importorskip("rosbags")
        Path("out").mkdir()
        return [word.format(tuned=tuned, drive=drive) for word in COMMANDS[name]]

    return prepared


_WHOLE: dict[tuple[str, ...], tuple[dict[str, bytes], int]] = {}


def whole(sigmaswarm, words: list[str], monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, bytes], int]:
    """Return the output of an undisturbed run of a command, and the number of its flushes; cached."""
    if tuple(words) in _WHOLE:
        Path("out").rmdir()
        return _WHOLE[tuple(words)]
    count, sync = [0], os.fsync

    def counted(handle: int) -> None:
        count[0] += 1
        sync(handle)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", counted)
        ended = sigmaswarm(*words)
    assert ended.code == 0, ended.err
    found = file_contents(Path("out"))
    assert found and not list(hidden(Path("out")))
    shutil.rmtree("out")
    _WHOLE[tuple(words)] = found, count[0]
    return found, count[0]


def put_old(name: str, found: dict[str, bytes], drive: Path) -> dict[str, bytes]:
    """Write older files in the place of a command's output."""
    Path("out").mkdir()
    if name == "import":
        shutil.copytree(drive, "out/d")
    elif name not in FOLDERS:
        for file in found:
            Path("out", file).parent.mkdir(exist_ok=True)
            Path("out", file).write_bytes(found[file] if file == RESULT_FILE else b"old")
    return file_contents(Path("out"))


@pytest.mark.parametrize(
    ("name", "moment"),
    quickly(
        product(COMMANDS, ("first", "last")),
        lambda *case: case in (("run-bag", "first"), ("evaluate", "last"), ("import", "last")),
    ),
)
def test_a_kill_leaves_no_incomplete_files(
    sigmaswarm, arguments, drives: Path, monkeypatch: pytest.MonkeyPatch, name: str, moment: str
):
    words = arguments(name)
    found, flushed = whole(sigmaswarm, words, monkeypatch)
    old = put_old(name, found, drives / "urban-clear-01")
    at = 1 if moment == "first" else flushed
    done = run(DYING, at, *words)
    assert done.returncode == -9, done.stderr
    left = file_contents(Path("out"))
    assert list(hidden(Path("out")))  # it was killed while it wrote
    shown = {
        file: text
        for file, text in left.items()
        if not any(part[0] == "." and part != RESULT_FILE for part in Path(file).parts)
    }
    assert set(old) <= set(shown)
    for file, text in shown.items():
        assert text in (old.get(file), found.get(file)), file
    files._sweep.cache_clear()
    assert sigmaswarm(*words).code == 0
    assert file_contents(Path("out")) == found  # no hidden files remain


@pytest.mark.parametrize("name", quickly([(name,) for name in COMMANDS], lambda name: name == "evaluate"))
def test_a_full_disk_leaves_what_was_there(
    sigmaswarm, arguments, drives: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    words = arguments(name)
    found, _ = whole(sigmaswarm, words, monkeypatch)
    old = put_old(name, found, drives / "urban-clear-01")
    done = run(COMMAND, *words, largest_file=1000)
    assert done.returncode == 2, done.stderr
    told = [line for line in done.stderr.splitlines() if line.startswith("sigmaswarm: ")]
    assert len(told) == 1
    assert "can't be written (File too large); free some space, or specify another folder" in told[0]
    assert "out" in told[0]
    left = file_contents(Path("out"))
    assert set(old) <= set(left)
    for file, text in left.items():
        assert text in (old.get(file), found.get(file)), file


@pytest.mark.parametrize(
    "name",
    quickly([(name,) for name in COMMANDS], lambda name: name in ("run", "simulate", "import")),
)
def test_a_disk_that_is_full_at_each_write(
    sigmaswarm, arguments, drives: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    """The flush of the first, the middle or the last file fails: old files are kept, and no single new file remains."""
    words = arguments(name)
    found, flushed = whole(sigmaswarm, words, monkeypatch)
    sync = os.fsync
    for at in sorted({1, (flushed + 1) // 2, flushed}):
        shutil.rmtree("out", ignore_errors=True)
        old, left = put_old(name, found, drives / "urban-clear-01"), [at]

        def full(handle: int, left: list[int] = left) -> None:
            left[0] -= 1
            if not left[0]:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            sync(handle)

        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", full)
            ended = sigmaswarm(*words)
        assert ended.code == 2, ended.err
        told = [line for line in ended.err.splitlines() if line.startswith("sigmaswarm: ")]
        assert len(told) == 1
        assert "out" in told[0] and "No space left on device" in told[0]
        assert "Traceback" not in ended.err
        now = file_contents(Path("out"))
        if name in FOLDERS:
            assert set(now) <= set(found)
            assert all(text == found[file] for file, text in now.items())
        else:
            assert now == old


def test_a_full_file_system(sigmaswarm, arguments, monkeypatch: pytest.MonkeyPatch):
    words = arguments("run")
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", "out"], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("only root can mount a small disk here")
    try:
        Path("out/e.csv").write_text("good")
        ended = sigmaswarm(*words)
        assert ended.code == 2
        assert ended.err == (
            "sigmaswarm: out/e.csv: can't be written (No space left on device); free some space, or specify another "
            "folder\n"
        )
        assert file_contents(Path("out")) == {"e.csv": b"good"}
    finally:
        subprocess.run(["umount", "-l", "out"], check=True)


def test_two_runs_into_one_bag(sigmaswarm, arguments):
    """One run writes the bag, the other run reports the conflict; neither removes files of the other."""
    words = arguments("run-bag")
    both = [Process(COMMAND, words) for _ in range(2)]
    ended = [(process.communicate()[1], process.wait()) for process in both]
    assert {code for _, code in ended} <= {0, 2}
    assert 0 in {code for _, code in ended}
    for said, code in ended:
        assert not code or "out/e.ros2: already exists" in said
    assert sorted(p.name for p in Path("out").iterdir()) == ["e.ros2"]
    found = sorted(p.name for p in Path("out/e.ros2").iterdir())
    assert found == ["e.ros2.mcap", "foxglove-layout.json", "metadata.yaml"]


def test_two_tunings_into_one_folder(drives: Path, here: Path):
    """One run fills the folder, the other run reports the conflict; a new run continues it."""
    words = [
        "tune",
        drives / "urban-clear-00",
        *["--out", "tuned", "--generations", "20", "--particles", "6"],
    ]
    both = [Process(COMMAND, words) for _ in range(2)]
    ended = [(process.communicate()[1], process.wait()) for process in both]
    assert 0 in {code for _, code in ended}
    for said, code in ended:
        assert not code or ("tuned: another run is writing to it" in said or "already contains a" in said)
    assert run(COMMAND, *words, "--resume").returncode == 0
