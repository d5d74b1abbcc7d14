"""A Dask scheduler and workers in separate processes on 127.0.0.1; each is ended by its process id."""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from processes import Process

SCHEDULER = "from distributed.cli.dask_scheduler import main; main()"
WORKER = "from distributed.cli.dask_worker import main; main()"
LOGGED = """
import os, sys
log = os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT)
os.dup2(log, 1), os.dup2(log, 2)
sys.path = [place for place in sys.path if not place.endswith("tests")]
"""
"""Code that runs first in a fork: it removes the modules of the tests, and redirects output to a log file."""
OTHER_VERSION = "import sigmaswarm.versions; sigmaswarm.versions.__version__ = '0.0.1'\n" + WORKER


class Processes:
    """A scheduler and workers that can be added and killed. A folder contains their files and logs."""

    def __init__(
        self, folder: Path, workers: int = 2, *, threads: int = 1, memory: str = "0", forked: bool = False
    ) -> None:
        """If ``forked``, workers are forks with all imports loaded; memory is shared with the template process."""
        self.folder, self._threads, self._memory, self._forked = folder, threads, memory, forked
        folder.mkdir(parents=True, exist_ok=True)
        self._started: dict[str, subprocess.Popen[bytes] | Process] = {}
        self.file = folder / "scheduler.json"
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(self.file)]
        options += ["--idle-timeout", "3600"]  # ends the scheduler if the test could not
        self._start("scheduler", SCHEDULER, options)
        self._wait(self.file.exists)
        for _ in range(workers):
            self.add()

    def __enter__(self) -> "Processes":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        for name in reversed(list(self._started)):
            self.kill(name)

    @property
    def address(self) -> str:
        """The address of the scheduler."""
        import json

        return str(json.loads(self.file.read_text())["address"])

    @property
    def workers(self) -> list[str]:
        """The names of the workers that were started and not killed."""
        return [name for name in self._started if name != "scheduler"]

    def add(self, program: str = WORKER, *options: str) -> str:
        """Start a worker without a nanny; return its name."""
        name = f"worker-{len(list(self.folder.glob('worker-*.log')))}"
        usual = [
            "--no-nanny",
            "--nthreads",
            str(self._threads),
            "--memory-limit",
            self._memory,
            "--no-dashboard",
        ]
        usual += ["--death-timeout", "60"]
        place = ["--host", "127.0.0.1", "--name", name, "--local-directory", str(self.folder / "scratch")]
        self._start(name, program, [self.address, *usual, *place, *options])
        return name

    def kill(self, name: str) -> None:
        """Kill one process by its id."""
        process = self._started.pop(name)
        process.kill()
        process.wait()

    def memory(self, name: str) -> int:
        """Return the peak memory of a process, bytes."""
        status = Path(f"/proc/{self._started[name].pid}/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024

    def processor(self, name: str) -> float:
        """Return the processor time of a process, s."""
        fields = Path(f"/proc/{self._started[name].pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def log(self) -> str:
        """Return the output of all processes."""
        return "".join(file.read_text() for file in sorted(self.folder.glob("*.log")))

    def _start(self, name: str, program: str, arguments: Sequence[str]) -> None:
        one_thread = {"OMP_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1", "MALLOC_TRIM_THRESHOLD_": "65536"}
        with (self.folder / f"{name}.log").open("wb") as log:
            if self._forked:
                self._started[name] = Process(LOGGED + program, [log.name, *arguments])
            else:
                command = [sys.executable, "-c", program, *arguments]
                self._started[name] = subprocess.Popen(
                    command, stdout=log, stderr=log, env=os.environ | one_thread
                )

    @staticmethod
    def _wait(done, seconds: float = 60.0) -> None:
        until = time.monotonic() + seconds
        while not done():
            if time.monotonic() > until:
                raise TimeoutError("the scheduler did not start")
            time.sleep(0.05)
