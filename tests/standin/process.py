"""The stand-in and the recorder as processes, and the available genuine clients."""

import atexit
import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from sigmaswarm_carla.pack import pack

TESTS = Path(__file__).parents[1]
PYTHONS = "SIGMASWARM_CARLA_PYTHONS"
"""Environment variable with interpreters for other versions of the client, separated as in PATH."""


@dataclass
class StandIn:
    """A stand-in with a separate world for one test; `log` contains the true values after the `with` block."""

    process: subprocess.Popen[str]
    port: int
    log: dict[str, Any] = field(default_factory=dict)


class _Keeper:
    """The server process of a test session, which is started when it is needed, also after its end."""

    process: subprocess.Popen[str] | None = None
    port = 0

    def order(self, **order: Any) -> None:
        """Send a command, and wait until it is executed."""
        if self.process is None or self.process.poll() is not None:
            self._start()
        assert self.process is not None
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"

    def _start(self) -> None:
        self.end()
        path = os.pathsep.join([str(TESTS), str(TESTS.parent / "src"), os.environ.get("PYTHONPATH", "")])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "standin.server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        )
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    def end(self) -> None:
        """End the process, which exits when its standard input closes."""
        if self.process is None:
            return
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.process = None


_KEEPER = _Keeper()
atexit.register(_KEEPER.end)


@contextmanager
def stand_in(folder: Path, version: str = "0.9.16", **faults: Any) -> Iterator[StandIn]:
    """Serve a new world until the `with` block ends."""
    _KEEPER.order(version=version, faults=faults)
    assert _KEEPER.process is not None
    running = StandIn(_KEEPER.process, _KEEPER.port)
    yield running
    if "die" not in faults:
        log = folder / "standin.json"
        _KEEPER.order(log=str(log))
        running.log.update(json.loads(log.read_text()))


@cache
def recorder() -> Path:
    """Return the recorder as one file, in the form in which users copy it to another machine."""
    folder = Path(tempfile.mkdtemp(prefix="sigmaswarm-recorder-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    pack(folder / "carla_recorder.pyz")
    return folder / "carla_recorder.pyz"


@cache
def _others() -> dict[str, str]:
    """Return interpreters by their version of the client."""
    named = [p for p in os.environ.get(PYTHONS, "").split(os.pathsep) if p]
    known = [found for name in ("python3.8", "python3.10") if (found := shutil.which(name))]
    ask = "import importlib.metadata as m; print(m.version('carla')); import carla"
    found: dict[str, str] = {}
    for python in [*named, *known]:
        done = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=False, timeout=60)
        if done.returncode == 0:
            found[done.stdout.strip()] = python
    return found


def python_with(version: str) -> str:
    """Return an interpreter that has this version of the genuine client, or skip the test."""
    try:
        if importlib.metadata.version("carla") == version:
            return sys.executable
    except importlib.metadata.PackageNotFoundError:
        pass
    if version not in _others():
        pytest.skip(f"no Python with carla=={version}; specify one in {PYTHONS}")
    return _others()[version]


def record(
    port: int, out: Path, *more: object, version: str = "0.9.16", home: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the recorder's file with the genuine client until it ends."""
    with recording(port, out, *more, version=version, home=home) as process:
        said, complained = process.communicate(timeout=150)
    return subprocess.CompletedProcess(process.args, process.returncode, said, complained)


@contextmanager
def recording(
    port: int, out: Path, *more: object, version: str = "0.9.16", home: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """Run the recorder's file with the genuine client."""
    arguments = [f"--port={port}", f"--out={out}", *map(str, more)]
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    # The client keeps a cache of maps in the home folder.
    process = subprocess.Popen(
        [python_with(version), str(recorder()), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**clean, "HOME": str(home or out.parent)},
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()
