"""`sigmaswarm record-carla`: the recorder runs in a separate process, and the command reports the result."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import sigmaswarm
from sigmaswarm.cli.record_carla import RECORDER, record_carla
from sigmaswarm_carla.options import Options, options_of
from standin.process import python_with, stand_in

PROGRAM = "from sigmaswarm.cli import main; main()"
BRAKE = ("--maneuver", "brake", "--environment", "clear", "--runs", "1")


def start(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    """Start the command in a new process group, as a terminal does."""
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "record-carla", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
        start_new_session=True,
    )


def end(*arguments: object, **environment: str) -> tuple[int, str, str]:
    process = start(*arguments, **environment)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


@pytest.mark.long
def test_records_a_drive(tmp_path: Path):
    python_with("0.9.16")
    with stand_in(tmp_path) as server:
        code, out, err = end(
            "--out", tmp_path / "d", "--port", server.port, *BRAKE, "--seed", 4, HOME=str(tmp_path)
        )
    assert code == 0, err
    assert "recorded 1 drive to" in out
    drive = sigmaswarm.read_drive(tmp_path / "d" / "brake-clear-00")
    assert drive.metadata["scenario"]["seed"] == 4


def test_an_interrupt_restores_the_server(tmp_path: Path):
    python_with("0.9.16")
    with stand_in(tmp_path) as server:
        many = *BRAKE[:-1], "20"  # long enough to be interrupted
        process = start("--out", tmp_path / "d", "--port", server.port, *many, HOME=str(tmp_path))
        assert process.stderr is not None
        assert "brake-clear-00" in process.stderr.readline()
        time.sleep(0.3)
        os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C: to the command and the recorder
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted; repeat the command with --resume" in err
    assert "Traceback" not in err
    assert server.log["settings"][0] is False
    assert server.log["actors"] == []


@pytest.mark.parametrize(
    ("client", "code", "said"),
    [
        ("raise ImportError('none')", 2, r"can't be imported \(none\); run pip install carla==VERSION"),
        ("import os; os.abort()", 2, "the CARLA client was killed by signal 6; complete drives are in"),
    ],
    ids=["missing", "crashing"],
)
def test_a_client_that_is_missing_or_dies(client: str, code: int, said: str, tmp_path: Path):
    import re

    (tmp_path / "carla.py").write_text(client)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    got, _, err = end("--out", tmp_path / "d", *BRAKE, PYTHONPATH=path)
    assert got == code
    assert re.search(f"^sigmaswarm: .*{said}", err)
    assert err.count("\n") == 1


def test_every_option_reaches_the_recorder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    handed: list[list[str]] = []

    class Done:
        def __init__(self, command: list[str]) -> None:
            handed.append(command)

        def wait(self) -> int:
            return 0

    monkeypatch.setattr(subprocess, "Popen", Done)
    given = {"host": "carla.lan", "port": 3000, "maneuver": ["turns", "brake"], "environment": ["fog"], "runs": 3,
             "seed": 5, "map": "Town04", "accel_noise": 0.1, "gyro_noise": 0.2, "gyro_bias": 0.3, "gps_noise": 0.4,
             "timeout": 7.0, "patience": 8.0, "brake_sweep": True, "resume": True}  # fmt: skip
    assert set(given) == {*RECORDER} - {"out"}
    with pytest.raises(SystemExit):
        record_carla(out=tmp_path, **given)
    took = dataclasses.asdict(options_of(handed[0][3:]))
    renamed = {"maneuver": "maneuvers", "environment": "environments"}
    wanted = {renamed.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in given.items()}
    assert took == {"out": tmp_path, **wanted}
    with pytest.raises(SystemExit):
        record_carla(out=tmp_path)
    assert options_of(handed[1][3:]) == Options(tmp_path)
