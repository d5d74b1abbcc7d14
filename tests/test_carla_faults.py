"""Faults of a CARLA server: a clear message, the world restored, no loss of data."""

import dataclasses
import hashlib
import json
import re
import shutil
import signal
import socket
import time
from pathlib import Path

import pytest

import sigmaswarm
from sigmaswarm_carla.options import Options
from standin.process import record, recording, stand_in
from standin.world import DEFAULTS
from support import quickly

BRAKE = ("--maneuver", "brake", "--environment", "clear", "--timeout", 3, "--patience", 1)
MID_DRIVE = 500  # ticks after the car was spawned


def digests(folder: Path) -> dict[str, str]:
    """Return the digest of every file of a drive."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


def check_one_line(said: str, *expected: str) -> None:
    """Check that the message is one line without a traceback."""
    line = said.strip().splitlines()[-1]
    assert line.startswith("sigmaswarm: ")
    assert "Traceback" not in said
    for text in expected:
        assert re.search(text, line), line


def check_world(log: dict) -> None:
    """Check that settings, weather and actors are as before."""
    assert log["settings"][:6] == DEFAULTS[:6]
    assert log["weather"] == [10.0] + 13 * [0.0]
    assert log["actors"] == []


def test_no_server(tmp_path: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    done = record(port, tmp_path / "d", *BRAKE)
    assert done.returncode == 2
    check_one_line(done.stderr, f"no CARLA server at 127.0.0.1:{port}; start one")


def test_something_else_than_a_server(tmp_path: Path):
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        done = record(mute.getsockname()[1], tmp_path / "d", *BRAKE, "--timeout", 0.5)
    assert done.returncode == 2
    check_one_line(done.stderr, "does not answer like a CARLA server", "--port")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"say_version": "0.9.13"}, "CARLA 0.9.13, but the client is 0.9.16.*pip install carla==0.9.13"),
        ({"ignore_settings": True}, "the server has fixed_delta_seconds = 0.05 instead of 0.01"),
        ({"ignore_physics": True}, "a wheel has max_brake_torque = 700 instead of 1400"),
        ({"fail_spawn": 99}, r"can't be spawned at .*collision at spawn position.*tried four routes"),
        ({"silent": ["gnss", 0]}, "the sensor gnss sent no data for frame .* within 3 s"),
        ({"mirror_gnss": True}, "fixes of brake-clear-00 are .* m from the car"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_refused_from_the_start(fault: dict, said: str, tmp_path: Path):
    with stand_in(tmp_path, **fault) as server:
        done = record(server.port, tmp_path / "d", *BRAKE, "--runs", 1)
    assert done.returncode == 2
    check_one_line(done.stderr, said)
    check_world(server.log)
    assert not list((tmp_path / "d").glob("brake*"))
    if "say_version" in fault:  # with this fault, the client makes no call that could kill it
        assert set(server.log["calls"]) == {"version"}


@pytest.fixture(scope="session")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a folder with one complete drive."""
    out = tmp_path_factory.mktemp("complete") / "drives"
    with stand_in(out.parent) as server:
        done = record(server.port, out, *BRAKE, "--runs", 1)
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (
            {"drop_frame": MID_DRIVE},
            r"frame \d+ of brake-clear-01 is missing: the server jumped from \d+ to \d+",
        ),
        (
            {"die": MID_DRIVE},
            "stopped answering: .*0 drives of this call are complete in .*--resume",
        ),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_broken_in_the_second_drive(fault: dict, said: str, complete: Path, tmp_path: Path):
    out = tmp_path / "d"
    shutil.copytree(complete, out)
    before = digests(out / "brake-clear-00")
    with stand_in(tmp_path, **fault) as server:
        done = record(server.port, out, *BRAKE, "--runs", 2, "--resume")
        if "die" in fault:
            assert server.process.wait(10) == 9
    assert done.returncode == 2
    check_one_line(done.stderr, said)
    if "die" not in fault:
        check_world(server.log)
    assert digests(out / "brake-clear-00") == before
    assert not (out / "brake-clear-01").exists()
    assert not list(out.glob(".*"))
    partial = sigmaswarm.read_drive(out / "incomplete" / "brake-clear-01-0")
    assert len(partial.imu) > 200


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "said"),
    quickly(
        [
            ("fail_spawn", "can't be spawned"),
            ("stuck", "got stuck after"),
            ("astray", "left its route after"),
        ],
        lambda fault, _: fault == "stuck",
    ),
)
def test_a_failed_run_takes_another_route(fault: str, said: str, tmp_path: Path):
    with stand_in(tmp_path, **{fault: 1}) as server:
        done = record(server.port, tmp_path / "d", *BRAKE, "--runs", 1)
    assert done.returncode == 0, done.stderr
    assert re.search(f"warning: .*{said}.*; trying another route", done.stderr)
    check_world(server.log)
    sigmaswarm.read_drive(tmp_path / "d" / "brake-clear-00")


@pytest.mark.long
def test_a_late_sensor_is_waited_for(complete: Path, tmp_path: Path):
    with stand_in(tmp_path, late=["imu", MID_DRIVE, 1.0]) as server:
        done = record(server.port, tmp_path / "late", *BRAKE, "--runs", 1)
    assert done.returncode == 0, done.stderr

    def text(folder: Path, file: str) -> str:
        return (folder / "brake-clear-00" / file).read_text()

    assert text(tmp_path / "late", "truth.csv") == text(complete, "truth.csv")
    for file in ("imu.csv", "gps.csv"):
        assert text(tmp_path / "late", file).count("\n") == text(complete, file).count("\n")


@pytest.mark.long
def test_a_lost_connection_is_taken_up_again(tmp_path: Path):
    out = tmp_path / "d"
    with stand_in(tmp_path, hang_up=MID_DRIVE) as server:
        done = record(server.port, out, *BRAKE, "--runs", 1, "--patience", 20)
    assert done.returncode == 0, done.stderr
    assert "the server answers again" in done.stderr
    check_world(server.log)
    assert len(sigmaswarm.read_drive(out / "brake-clear-00").imu) > 1000
    assert len(sigmaswarm.read_drive(out / "incomplete" / "brake-clear-00-0").imu) > 200


@pytest.mark.long
def test_a_connection_that_is_lost_again_and_again_is_given_up(tmp_path: Path):
    with stand_in(tmp_path, hang_up=200, always=True) as server:
        done = record(server.port, tmp_path / "d", *BRAKE, "--runs", 1, "--timeout", 1)
    assert done.returncode == 2
    assert done.stderr.count("the server answers again") == 3
    check_one_line(done.stderr, "stopped answering: .*0 drives of this call are complete in .*--resume")
    check_world(server.log)


@pytest.mark.parametrize(
    "how", quickly([(signal.SIGINT,), (signal.SIGTERM,)], lambda how: how == signal.SIGTERM)
)
def test_interrupted(how: signal.Signals, tmp_path: Path):
    with stand_in(tmp_path) as server, recording(server.port, tmp_path / "d", *BRAKE) as process:
        assert process.stderr is not None
        assert "brake-clear-00" in process.stderr.readline()
        time.sleep(0.3)
        process.send_signal(how)
        assert process.wait(20) == 130
        said = process.stderr.read()
    check_one_line(said, "interrupted; repeat the command with --resume")
    check_world(server.log)


def test_after_a_recorder_was_killed_the_next_one_puts_the_server_in_order(complete: Path, tmp_path: Path):
    out = tmp_path / "d"
    shutil.copytree(complete, out)
    before = digests(out / "brake-clear-00")
    with stand_in(tmp_path) as server:
        with recording(server.port, out, *BRAKE, "--runs", 2, "--resume") as process:
            assert process.stderr is not None
            assert "brake-clear-01" in process.stderr.readline()
            process.kill()
        done = record(server.port, out, *BRAKE, "--runs", 1, "--resume")
        assert done.returncode == 0  # nothing is missing, so the server is not contacted
        done = record(server.port, out, *BRAKE, "--runs", 2, "--resume")
    assert done.returncode == 0, done.stderr
    assert "settings of a recording that was killed" in done.stderr
    assert "recorded 1 drive to" in done.stdout  # only the missing drive is recorded
    assert digests(out / "brake-clear-00") == before
    assert len(sigmaswarm.read_drive(out / "brake-clear-01").imu) > 1000
    assert server.log["settings"][:6] == DEFAULTS[:6]
    assert server.log["actors"] == []


def test_what_is_there_is_not_overwritten_nor_mixed(tmp_path: Path):
    out = tmp_path / "d"
    (out / "brake-clear-00").mkdir(parents=True)
    (out / "brake-clear-00" / "imu.csv").write_text("t\n")
    done = record(1, out, *BRAKE)
    assert done.returncode == 2
    check_one_line(done.stderr, "already contains brake-clear-00.*--resume")
    (out / "recording.json").write_text('{"options": {"seed": 3}}')
    done = record(1, out, *BRAKE, "--resume")
    check_one_line(done.stderr, "recorded with seed 3, not 0")
    done = record(1, out, *BRAKE, "--resume", "--seed", 3, "--accel-noise", 0)
    check_one_line(done.stderr, "recorded with accel_noise None, not 0.0")
    figures = dataclasses.replace(Options(out), seed=3).figures()
    (out / "recording.json").write_text(json.dumps({"options": figures}))
    done = record(1, out, *BRAKE, "--resume", "--seed", 3, "--brake-sweep")
    check_one_line(done.stderr, "recorded without --brake-sweep")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--maneuver", "fly"), "no maneuver is called 'fly'; choose from cruise, turns"),
        (("--environment", "snow"), "no environment is called 'snow'; choose from clear"),
        (("--runs", 0), "--runs is 0; choose 1 or more"),
        (("--gps-noise", -1), "--gps-noise is -1.0; choose 0 or more"),
    ],
)
def test_mistakes(more: tuple, said: str, tmp_path: Path):
    done = record(1, tmp_path / "d", *more)
    assert done.returncode == 2
    check_one_line(done.stderr, said)


@pytest.mark.long
def test_maps(tmp_path: Path):
    with stand_in(tmp_path) as server:
        unknown = record(server.port, tmp_path / "d", *BRAKE, "--map", "Town99")
        unfit = record(
            server.port, tmp_path / "d", "--maneuver", "brake", "cruise", "--map", "Village", "--timeout", 5
        )
    assert (unknown.returncode, unfit.returncode) == (2, 2)
    check_one_line(unknown.stderr, "the server has no map 'Town99'; it has Grid, Village")
    check_one_line(unfit.stderr, "the map Carla/Maps/Village/Village has no straight stretch of .*Town06")
    assert "drive 1" not in unfit.stderr  # the fault is reported before the first drive
    check_world(server.log)
