"""Reading in forked children: what works, works; what would wait for ever is refused at once."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest

from sigmaswarm.drives.writer import write_drive
from support import make_drive

pytestmark = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="no process can be forked here"
)
PROGRAM = """
import multiprocessing, sys, warnings
warnings.simplefilter("ignore", RuntimeWarning)  # Polars may warn of forks itself
import sigmaswarm

def read(queue, depth):
    if depth:
        fork(depth - 1, queue).join()
        return
    try:
        queue.put(len(sigmaswarm.read_drive("drive").imu))
    except sigmaswarm.SigmaswarmError as error:
        queue.put(str(error))

def fork(depth, queue, method="fork"):
    child = multiprocessing.get_context(method).Process(target=read, args=(queue, depth))
    child.start()
    return child

if __name__ == "__main__":
    before, method, depth = sys.argv[1:]
    if before == "read":
        sigmaswarm.read_drive("drive")
    elif before == "write":
        time = range(200)
        imu, gps = sigmaswarm.Imu(time, time, time, time), sigmaswarm.Gps(time, time, time)
        sigmaswarm.write_drive(sigmaswarm.Drive("other", imu, gps), "other")
    elif before == "polars":
        import polars
        polars.DataFrame({"a": range(1000), "b": range(1000)}).sort("a").select(polars.all().sum())
    elif before == "late":  # a pool whose first thread has not run yet: it has no name
        import ctypes, threading
        named = threading.Event()
        def second():
            ctypes.CDLL(None).prctl(15, b"polars-1")  # PR_SET_NAME
            named.set()
            threading.Event().wait()
        threading.Thread(target=second, daemon=True).start()
        named.wait()
    queue = multiprocessing.get_context(method).Queue()
    child = fork(int(depth), queue, method)
    try:
        print(queue.get(timeout=150))
    finally:
        child.kill()
"""


@pytest.mark.parametrize(
    ("before", "method", "depth", "works"),
    [
        ("nothing", "fork", 0, True),
        ("nothing", "fork", 1, True),
        ("read", "fork", 0, False),
        ("read", "fork", 1, False),
        ("write", "fork", 0, False),
        ("polars", "fork", 0, False),
        ("late", "fork", 0, False),
        ("read", "spawn", 0, True),
        ("read", "forkserver", 0, True),
    ],
)
def test_reading_in_a_child(tmp_path: Path, before: str, method: str, depth: int, works: bool):
    if before in ("polars", "late") and sys.platform != "linux":
        pytest.skip("only Linux tells which threads run")
    write_drive(make_drive(duration=20), tmp_path / "drive")
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "program.py", before, method, str(depth)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    if works:
        assert done.stdout == "2001\n"
    else:
        assert 'start processes with multiprocessing.get_context("spawn")' in done.stdout
        assert done.stdout.count("\n") == 1
