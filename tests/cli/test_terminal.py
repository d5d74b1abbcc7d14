"""Output on a terminal that is narrow, ASCII only, full or closed, and for unusual names."""

import os
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
import tomli_w

from sigmaswarm.cli.terminal import MAX_LINE_LENGTH
from support import no_pictures, quickly, some

PROGRAM = "from sigmaswarm.cli import main; main()"
EVIL = "a\x1b]0;owned\x9cb\x1b[2J"


def command(*arguments: object, stdout: object = subprocess.PIPE, **environment: str):
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        check=False,
        env=os.environ | environment,
    )


@pytest.fixture
def drive(drives: Path, here: Path):
    """Return a function that makes a drive with a given name in drive.toml."""

    def made(name: str) -> Path:
        shutil.copytree(drives / "urban-clear-00", "named", dirs_exist_ok=True)
        file = Path("named", "drive.toml")
        file.write_text(tomli_w.dumps(tomllib.loads(file.read_text()) | {"name": name}))
        return Path("named")

    return made


@pytest.mark.parametrize("out", some(["x[/y]", "x[bold]y", ":smile:"], 3))
def test_a_path_is_not_interpreted_as_markup(sigmaswarm, tuned: Path, drives: Path, here: Path, out: str):
    (here / out).mkdir(parents=True)
    for arguments in (
        ("export", tuned, "--to", "robot_localization", "--out", f"{out}/x"),
        ("run", tuned, drives / "urban-clear-00", "--out", f"{out}/e.csv"),
        ("split", drives / "urban-clear-00", "--out", f"{out}/p"),
    ):
        ended = sigmaswarm(*arguments)
        assert (ended.code, ended.err) == (0, "")
        assert out in ended.out


@pytest.mark.usefixtures("painted")
@pytest.mark.parametrize(
    "name",
    quickly(
        [("$^$" + EVIL,), ("$^$",), ("a$b$c",), (EVIL,), ("日本語",), ("[x]",)],
        lambda name: "$" in name and EVIL in name,
    ),
)
def test_any_name_can_be_drawn_and_printed(sigmaswarm, drive, tuned: Path, name: str):
    shown = name.replace(EVIL, r"a\x1b]0;owned\x9cb\x1b[2J")
    assert sigmaswarm("plot", drive(name), "--out", "p.png").code == 0
    ended = sigmaswarm("doctor", "named")
    assert ended.out.startswith(shown)
    with no_pictures():
        ended = sigmaswarm("evaluate", tuned, "named", "--out", "e")
    assert (ended.code, ended.err) == (0, "")
    assert not {c for c in ended.out if not c.isprintable()} - {"\n"}


def test_a_control_character_of_a_file_is_printed_as_an_escape(sigmaswarm, drive):
    file = drive("n") / "imu.csv"
    file.write_text(file.read_text().replace("t,", "\x1b[2Jt,", 1))
    ended = sigmaswarm("doctor", "named")
    assert ended.code == 2
    assert "\x1b" not in ended.err
    assert r"\x1b[2Jt" in ended.err


def test_a_long_error_is_cut_in_the_middle(sigmaswarm):
    ended = sigmaswarm("run", "n" * 100 + "/" + "m" * 3000, "d", "--out", "x.csv")
    assert ended.code == 2
    assert len(ended.err) < MAX_LINE_LENGTH + 40
    assert " ... " in ended.err


@pytest.mark.parametrize(
    "environment",
    quickly(
        [
            ({"PYTHONIOENCODING": "ascii", "COLUMNS": "0"},),
            ({"PYTHONIOENCODING": "latin-1"},),
            ({"COLUMNS": "1"},),
        ],
        lambda environment: "0" in environment.values(),
    ),
    ids=str,
)
def test_any_terminal_will_do(drive, environment: dict[str, str]):
    done = command("doctor", drive("drée 日"), **environment)
    assert (done.returncode, done.stderr) in ((0, b""), (1, b""))
    assert len(done.stdout.splitlines()) < 60
    assert b"SERIOUS" in done.stdout or b"no serious fault" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    quickly(
        [(["doctor", "named"],), (["doctor", "named", "--json"],), (["--help"],)],
        lambda arguments: arguments == ["--help"],
    ),
    ids=str,
)
def test_a_closed_pipe_is_not_an_error(drive, arguments: list[str]):
    drive("n")
    read, write = os.pipe()
    os.close(read)
    done = command(*arguments, stdout=write)
    os.close(write)
    assert done.stderr == b""
    assert done.returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_output_is_reported(drive):
    drive("n")
    with Path("/dev/full").open("wb") as full:
        done = command("split", "named", "--out", "parts", stdout=full)
    assert done.returncode == 2
    assert done.stderr == b"sigmaswarm: the output can't be written: No space left on device\n"


@pytest.mark.parametrize(
    "error", [MemoryError(), RecursionError("deep"), ZeroDivisionError("by\nzero")], ids=repr
)
def test_the_unforeseen_is_one_line_with_a_code_of_its_own(
    sigmaswarm, drive, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
):
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(import_module("sigmaswarm.cli.doctor"), "_read", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    ended = sigmaswarm("doctor", drive("n"))
    assert ended.code == 3
    assert ended.err.startswith("sigmaswarm: unexpected error: ")
    assert ended.err.count("\n") == 1
    (story,) = tmp_path.glob("sigmaswarm-*.txt")
    assert str(story) in ended.err
    assert "Traceback (most recent call last)" in story.read_text()
