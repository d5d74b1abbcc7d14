"""The command in a separate process: response time, imported modules, and compilation."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from processes import COMMAND, Process, run
from sigmaswarm.drives.writer import write_drive
from support import make_drive, quickly

HEAVY = ["numba", "polars", "matplotlib", "scipy", "numpy"]  # pydantic defines options of the help


def sigmaswarm(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | environment,
    )


def test_help_imports_nothing_heavy():
    program = f"""
import json, sys
from sigmaswarm.cli import main
for arguments in (["--version"], ["--help"], ["tone"], ["tune", "--help"]):
    sys.argv[1:] = arguments
    try:
        main()
    except SystemExit:
        pass
    imported = sorted(set(sys.modules) & set({HEAVY}))
    print(json.dumps([arguments, imported]), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    seen = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("[[")]
    assert len(seen) == 4
    assert [arguments for arguments, imported in seen if imported] == []


@pytest.mark.long
def test_without_arguments_help_is_printed():
    done, helped = sigmaswarm(), sigmaswarm("--help")
    assert (done.returncode, done.stdout) == (0, helped.stdout)


def test_the_installed_command_runs():
    script = Path(sys.executable).with_name("sigmaswarm")
    if not script.exists():
        pytest.skip("sigmaswarm is not installed as a command beside this Python")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip()[0].isdigit()


@pytest.mark.long
@pytest.mark.parametrize("empty", quickly([(False,), (True,)], lambda empty: not empty))
def test_the_second_start_compiles_nothing(tmp_path: Path, drives: Path, tuned: Path, empty: bool):
    """Numba reports loads and saves of compiled code."""
    environment = {"NUMBA_DEBUG_CACHE": "1"} | ({"NUMBA_CACHE_DIR": str(tmp_path / "cache")} if empty else {})
    commands = [
        ["run", tuned, drives / "urban-clear-00", "--out", tmp_path / "x.csv", "--json"],
        ["evaluate", tuned, drives / "urban-clear-01", "--json"],
    ]
    said, took = [], []
    for command in commands:
        start = time.perf_counter()
        # If the cache exists, the first run only completes it.
        done = sigmaswarm(*command, **environment) if empty or said else run(COMMAND, *command)
        took.append(time.perf_counter() - start)
        assert done.returncode == 0, done.stderr
        said.append([line for line in (done.stdout + done.stderr).splitlines() if line.startswith("[cache]")])
    assert any("data saved" in line for line in said[0]) or not empty
    assert any("data loaded" in line for line in said[1])
    assert [line for line in said[1] if "saved" in line] == []
    print(f"first start {took[0]:.1f} s, second {took[1]:.1f} s")


def test_an_interrupt_states_how_to_continue(tmp_path: Path):
    write_drive(make_drive(duration=40), tmp_path / "drive")
    command = ["tune", tmp_path / "drive", "--out", tmp_path / "t", "--generations", 100000]
    process = Process(COMMAND, command)
    deadline = time.monotonic() + 120
    while not (tmp_path / "t" / "checkpoint-000.npz").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill(signal.SIGINT)
    err = process.communicate()[1]
    assert process.wait() == 130
    assert err.splitlines()[-1] == "sigmaswarm: interrupted; repeat the command with --resume to continue"
    assert "Traceback" not in err
