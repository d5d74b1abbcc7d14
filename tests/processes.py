"""Fork processes that have all imports of a command, for tests that need a process but do not test its start.

Imports and compiled filters take 2 to 3 s. Therefore, one template process loads them once per session, and each
process of a test is a fork of it with its own arguments, environment, folder and outputs. Such a process can be killed
like any other. cli/test_process.py tests the start itself, with new processes.
"""

import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

COMMAND = "from sigmaswarm.cli import main; main()"


class Process:
    """A running process. Unless `communicate` reads its output, the output must fit into the buffer of a pipe."""

    def __init__(
        self, program: str, arguments: Sequence[object], largest_file: int | None = None, imports: str = ""
    ) -> None:
        """Start the process; the template imports the module ``imports`` first, once for all later processes."""
        pipes = [os.pipe(), os.pipe()]
        order = {
            "program": program,
            "imports": imports,
            "arguments": [str(word) for word in arguments],
            "environment": dict(os.environ),
            "folder": str(Path.cwd()),
            "largest_file": largest_file,
        }
        self.pid = int(_TEMPLATE.ask(order, [write for _, write in pipes]))
        for _, write in pipes:
            os.close(write)
        self._in_words = [os.fdopen(read, encoding="utf-8") for read, _ in pipes]
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code as `subprocess.Popen.poll` does; None while the process runs."""
        if self._code is None:
            self._code = _TEMPLATE.ask({"ended": self.pid})
        return self._code

    def kill(self, how: signal.Signals = signal.SIGKILL) -> None:
        os.kill(self.pid, how)

    def line(self) -> str:
        """Return the next line of its standard output."""
        return self._in_words[0].readline()

    def communicate(self) -> tuple[str, str]:
        """Return its complete standard output and standard error."""
        with ThreadPoolExecutor(2) as pool:
            out, err = pool.map(lambda file: file.read(), self._in_words)
        return out, err

    def wait(self, seconds: float = 300.0) -> int:
        """Wait until the process ends; return its exit code."""
        late = time.monotonic() + seconds
        while (code := self.poll()) is None:
            assert time.monotonic() < late, "it does not end"
            time.sleep(0.002)
        for file in self._in_words:
            file.close()
        return code


def run(
    program: str, *arguments: object, largest_file: int | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program until it ends; it can't write files of more bytes than ``largest_file``."""
    process = Process(program, arguments, largest_file)
    out, err = process.communicate()
    return subprocess.CompletedProcess(program, process.wait(), out, err)


class _Template:
    """The process from which others are forked; started on first use."""

    channel: socket.socket | None = None

    def ask(self, order: dict[str, Any], files: Sequence[int] = ()) -> Any:
        if self.channel is None:
            self._start()
        assert self.channel is not None
        socket.send_fds(self.channel, [json.dumps(order).encode() + b"\n"], files)
        return json.loads(_line(self.channel, b""))

    def _start(self) -> None:
        self.channel, theirs = socket.socketpair()
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            [sys.executable, "-m", "processes", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
        )
        theirs.close()
        atexit.register(lambda channel: (channel.close(), process.wait()), self.channel)


_TEMPLATE = _Template()


def _line(channel: socket.socket, begun: bytes) -> bytes:
    while not begun.endswith(b"\n"):
        more = channel.recv(1 << 20)
        assert more, "the template has ended"
        begun += more
    return begun


def _serve(channel: socket.socket) -> None:
    """In the template process: fork on request, and report exit codes."""
    from sigmaswarm import evaluate, tune
    from support import make_drive

    for module in ("filterpy.kalman", "matplotlib.pyplot", "scipy.stats", "sigmaswarm.cli.common"):
        import_module(module)

    drive = make_drive(duration=20.0)
    evaluate(drive, tune(drive, particles=2, generations=1).parameters)  # loads compiled code
    while True:
        data, files, _, _ = socket.recv_fds(channel, 1 << 20, 2)
        if not data:
            return
        order = json.loads(_line(channel, data))
        if "ended" in order:
            pid, status = os.waitpid(order["ended"], os.WNOHANG)
            reply = os.waitstatus_to_exitcode(status) if pid else None
        else:
            if order["imports"]:
                import_module(order["imports"])
            reply = os.fork()
            if reply == 0:
                channel.close()
                _become(order, files)
            for file in files:
                os.close(file)
        channel.sendall(json.dumps(reply).encode() + b"\n")


def _become(order: dict[str, Any], files: list[int]) -> NoReturn:
    """In the fork: run the program with the given arguments, environment, folder and outputs."""
    for file, standard in zip(files, (1, 2), strict=True):
        os.dup2(file, standard)
        os.close(file)
    sys.stdout, sys.stderr = (open(n, "w", encoding="utf-8", closefd=False) for n in (1, 2))  # noqa: SIM115 (never closed)
    os.chdir(order["folder"])
    os.environ.clear()
    os.environ.update(order["environment"])
    sys.argv = ["sigmaswarm", *order["arguments"]]
    if order["largest_file"] is not None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (order["largest_file"],) * 2)
    code: Any = 0
    try:
        exec(compile(order["program"], "<program>", "exec"), {"__name__": "__main__"})
    except SystemExit as ended:
        code = ended.code or 0
        if not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except BaseException:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
