"""Files are written completely or not at all, and only files of this process are removed."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from sigmaswarm import files
from sigmaswarm.errors import InputError
from sigmaswarm.files import (
    RESULT_FILE,
    atomic_file,
    atomic_folder,
    earlier_result,
    free_path,
    locked_folder,
    make_folder,
    staged_files,
    write_atomically,
    write_json,
)

HIDDEN = ".x.csv.sigmaswarm-0123456789ab"


@pytest.fixture(autouse=True)
def unswept():
    """Make the sweeper treat each test as a new process."""
    files._sweep.cache_clear()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_has_the_mode_of_any_new_file(tmp_path: Path):
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "a", "text, é")
        with atomic_folder(tmp_path / "b") as new:
            new.mkdir()
    finally:
        os.umask(before)
    assert (tmp_path / "a").read_bytes() == "text, é".encode()
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "b").stat().st_mode & 0o777 == 0o750
    assert names(tmp_path) == ["a", "b"]


def test_json_keeps_every_bit(tmp_path: Path):
    write_json(tmp_path / "a.json", {"a": 0.1})
    assert (tmp_path / "a.json").read_text() == '{\n  "a": 0.1\n}\n'


def test_not_finite_numbers_become_null():
    assert files.nan_to_none({1: [float("nan"), (1.5, float("-inf"))], "b": "nan"}) == {
        "1": [None, [1.5, None]],
        "b": "nan",
    }


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_block_that_fails_leaves_what_was_there(tmp_path: Path, error: type[BaseException]):
    (tmp_path / "x.csv").write_text("good")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "good").touch()
    with pytest.raises(error), atomic_file(tmp_path / "x.csv") as file:
        file.write(b"half")
        raise error
    with pytest.raises(error), atomic_folder(tmp_path / "d", replace=True) as new:
        new.mkdir()
        raise error
    assert (tmp_path / "x.csv").read_text() == "good"
    assert names(tmp_path) == ["d", "x.csv"]
    assert names(tmp_path / "d") == ["good"]


def test_a_planted_link_is_replaced_and_not_followed(tmp_path: Path):
    (tmp_path / "secret").write_text("kept")
    for name in ("x.csv", ".x.csv.part"):  # an earlier version followed such links
        (tmp_path / name).symlink_to(tmp_path / "secret")
    write_atomically(tmp_path / "x.csv", "new")
    assert (tmp_path / "secret").read_text() == "kept"
    assert not (tmp_path / "x.csv").is_symlink()
    assert (tmp_path / "x.csv").read_text() == "new"


def test_something_else_in_the_way_is_named(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    for path, said in (
        (tmp_path, "is a folder; specify a file"),
        (tmp_path / "pipe", "is not a regular file"),
        (tmp_path / "file" / "x", "can't be written (Not a directory); specify another folder"),
        (tmp_path / "none" / "x", "can't be written (No such file or directory)"),
    ):
        with pytest.raises(InputError) as caught:
            write_atomically(path, "")
        assert str(caught.value).startswith(f"{path}: {said}")
    with pytest.raises(
        InputError, match=r"file: can't be created as a folder \(File exists\); choose another --out"
    ):
        make_folder(tmp_path / "file")
    assert names(tmp_path) == ["file", "pipe"]


def limited(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script in a process that can write at most 1000 bytes to a file, which simulates a full disk."""
    return subprocess.run(
        [sys.executable, "-c", "from pathlib import Path\nfrom sigmaswarm.files import *\n" + script],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)),
    )


@pytest.mark.parametrize(
    "script",
    [
        'write_atomically(Path("x.csv"), "a" * 2000)',
        'import numpy as np\nwith atomic_file(Path("x.csv")) as f: np.savez(f, a=np.zeros(999))',
        'import numpy as np\nwith atomic_file(Path("x.csv")) as f: np.savetxt(f, np.zeros(999))',
        'import polars as pl\nwith atomic_file(Path("x.csv")) as f: '
        'pl.DataFrame({"a": range(999)}).write_csv(f)',
        'from scipy.io import savemat\nwith atomic_file(Path("x.csv")) as f: savemat(f, {"a": [0.5] * 999})',
    ],
    ids=["bytes", "npz", "text", "polars", "mat"],
)
def test_a_full_disk_leaves_the_good_file_and_is_told_with_its_name(tmp_path: Path, script: str):
    (tmp_path / "x.csv").write_text("good")
    done = limited(script, tmp_path)
    assert done.stderr.splitlines()[-1] == (
        "sigmaswarm.errors.InputError: x.csv: can't be written (File too large); free some space, or specify another "
        "folder"
    )
    assert (tmp_path / "x.csv").read_text() == "good"
    assert names(tmp_path) == ["x.csv"]


def test_a_full_disk_leaves_the_good_folder(tmp_path: Path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "good").touch()
    script = """
with atomic_folder(Path("d"), replace=True) as new:
    new.mkdir()
    (new / "a").write_text("a" * 2000)
"""
    done = limited(script, tmp_path)
    assert "InputError: d: can't be written (File too large)" in done.stderr
    assert names(tmp_path) == ["d"]
    assert names(tmp_path / "d") == ["good"]


def test_a_folder_that_somebody_made_meanwhile_stays(tmp_path: Path):
    with (
        pytest.raises(InputError, match="d: already exists; delete it"),
        atomic_folder(tmp_path / "d") as new,
    ):
        new.mkdir()
        (tmp_path / "d").mkdir()
        (tmp_path / "d" / "theirs").touch()
    assert names(tmp_path) == ["d"]
    assert names(tmp_path / "d") == ["theirs"]


@pytest.mark.parametrize(
    "body",
    ['with atomic_file(Path("x.csv")) as f:', 'with atomic_folder(Path("d")) as f:\n    f.mkdir()'],
    ids=["file", "folder"],
)
def test_what_a_killed_run_left_is_swept(tmp_path: Path, body: str):
    done = limited(f"import os, signal\n{body}\n    os.kill(os.getpid(), signal.SIGKILL)", tmp_path)
    assert done.returncode == -9
    left = names(tmp_path)
    assert len(left) == 2 and all(name.startswith((".x.csv.sigmaswarm-", ".d.sigmaswarm-")) for name in left)
    write_atomically(tmp_path / "y.csv", "")
    assert names(tmp_path) == ["y.csv"]


def test_what_another_run_is_at_stays(tmp_path: Path):
    with atomic_file(tmp_path / "x.csv") as file, atomic_folder(tmp_path / "d") as new:
        new.mkdir()
        files._sweep.cache_clear()
        write_atomically(tmp_path / "x.csv", "another's")
        file.write(b"own")
    assert names(tmp_path) == ["d", "x.csv"]
    assert (tmp_path / "x.csv").read_text() == "own"


def test_what_only_looks_like_ours_stays(tmp_path: Path):
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").touch()
    (tmp_path / HIDDEN).symlink_to(tmp_path / "precious")
    (tmp_path / f"{HIDDEN}.lock").symlink_to(tmp_path / "precious" / "file")
    for name in (
        ".x.csv.part",
        ".d.0a1b2c3d",
        HIDDEN[1:],
        f"{HIDDEN}c",
        f"{HIDDEN[1:]}.lock",
        f"{HIDDEN}c.lock",
    ):
        (tmp_path / name).touch()
    before = names(tmp_path)
    write_atomically(tmp_path / "y.csv", "")
    assert names(tmp_path) == sorted([*before, "y.csv"])
    assert names(tmp_path / "precious") == ["file"]


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_what_somebody_else_left_stays(tmp_path: Path):
    for name in (HIDDEN, f"{HIDDEN}.lock"):
        (tmp_path / name).touch()
        os.chown(tmp_path / name, 12345, 12345)
    write_atomically(tmp_path / "y.csv", "")
    assert names(tmp_path) == [HIDDEN, f"{HIDDEN}.lock", "y.csv"]


def test_a_folder_taken_away_to_be_replaced_comes_back(tmp_path: Path):
    """The process is killed between the two renames; the old folder is restored."""
    script = """
import os, signal
rename = Path.rename
def dying(self, to):
    rename(self, to)
    os.kill(os.getpid(), signal.SIGKILL)
Path.rename = dying
with atomic_folder(Path("d"), replace=True) as new:
    new.mkdir()
"""
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "good").touch()
    assert limited(script, tmp_path).returncode == -9
    assert "d" not in names(tmp_path)
    write_atomically(tmp_path / "y.csv", "")
    assert names(tmp_path) == ["d", "y.csv"]
    assert names(tmp_path / "d") == ["good"]


def test_a_folder_is_held_by_one_run(tmp_path: Path):
    out = tmp_path / "out"
    with (
        files.locked_folder(out),
        pytest.raises(InputError, match=r"out: another run is writing to it"),
        files.locked_folder(out),
    ):
        pass
    with files.locked_folder(out):
        pass


def test_a_killed_run_holds_nothing(tmp_path: Path):
    dying = "import os, sys; from pathlib import Path; from sigmaswarm.files import locked_folder\n"
    dying += "with locked_folder(Path(sys.argv[1])): os.kill(os.getpid(), 9)"
    done = subprocess.run([sys.executable, "-c", dying, str(tmp_path)], check=False)
    assert done.returncode == -9
    with files.locked_folder(tmp_path):
        pass


def test_a_run_removes_lock_files_of_killed_ones_in_folders_that_it_does_not_write(tmp_path: Path):
    left = tmp_path / "trials" / ".trial-001.sigmaswarm-d50eb2f8a41a.lock"
    left.parent.mkdir()
    left.touch()
    with locked_folder(tmp_path):
        assert not left.exists()


def test_a_result_replaces_its_own_files_alone(tmp_path: Path):
    """The files of an earlier result are replaced or removed; other files in the folder are not changed."""
    out = tmp_path / "out"

    def write(kind: str, **texts: str) -> None:
        with staged_files(out, kind) as new:
            for name, text in texts.items():
                (new / name.replace("_", "/")).parent.mkdir(exist_ok=True)
                write_atomically(new / name.replace("_", "/"), text)

    write("export", a="1", b="1", sub_c="1")
    (out / "mine").write_text("mine")
    write("export", a="2")
    assert {f.name: f.read_text() for f in out.iterdir() if f.name != RESULT_FILE} == {
        "a": "2",
        "mine": "mine",
    }
    for kind, text in (("evaluation", r"out: is not empty and contains no evaluation; choose another --out"),
                       ("export", r"mine: is not part of an earlier export; move it")):  # fmt: skip
        with pytest.raises(InputError, match=text):
            write(kind, a="3", mine="3")
        assert {f.name: f.read_text() for f in out.iterdir() if f.name != RESULT_FILE} == {
            "a": "2",
            "mine": "mine",
        }
    (out / RESULT_FILE).unlink()
    with pytest.raises(InputError, match="is not empty and contains no export"):
        earlier_result(out, "export")
    assert earlier_result(out, "tuning", "mine") is None  # written by a version without lists of files
    with pytest.raises(InputError, match="a: is not part of an earlier export; move it"):
        write("export", a="3")
    write("export", b="3")  # next to files of the user
    (out / "b.c").write_text("/* Tuned and written by sigmaswarm 0.3.0. */")  # an export that listed no files
    (out / "c.c").write_text("int mine;")
    with staged_files(out, "export") as new:
        write_atomically(new / "b.c", "new")
    with pytest.raises(InputError, match=r"c\.c: is not part"), staged_files(out, "export") as new:
        write_atomically(new / "c.c", "new")
    assert ((out / "b.c").read_text(), (out / "c.c").read_text()) == ("new", "int mine;")


def test_a_list_of_files_can_not_name_files_outside_of_its_folder(tmp_path: Path):
    (tmp_path / "outside").write_text("mine")
    out = tmp_path / "out"
    with staged_files(out, "export") as new:
        write_atomically(new / "a", "1")
    files = ["../outside", str(tmp_path / "outside"), "a"]
    (out / RESULT_FILE).write_text(json.dumps({"kind": "export", "files": files}))
    with staged_files(out, "export") as new:
        write_atomically(new / "b", "1")
    assert (tmp_path / "outside").read_text() == "mine" and not (out / "a").exists()


def test_a_folder_with_a_file_of_the_system_alone_is_empty(tmp_path: Path):
    (tmp_path / ".DS_Store").touch()
    assert earlier_result(tmp_path, "evaluation") == frozenset()


def test_a_free_path_continues_the_numbers_of_an_earlier_one(tmp_path: Path):
    for name in ("parts", "parts-2", "parts-4", "2026-01-05"):
        (tmp_path / name).mkdir()
    free = {
        name: free_path(tmp_path / name).name
        for name in ("parts", "parts-2", "parts-4", "parts-5", "2026-01-05", "new")
    }
    three = dict.fromkeys(("parts", "parts-2", "parts-4"), "parts-3")
    assert free == three | {"parts-5": "parts-5", "2026-01-05": "2026-01-05-2", "new": "new"}
