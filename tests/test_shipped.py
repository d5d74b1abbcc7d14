"""Kernels that a wheel brings: the same bits, and whatever does not match is compiled."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numba
import pytest
from numba.core.registry import cpu_target

import sigmaswarm
from sigmaswarm import shipped, write_drive
from support import make_drive

HOOK = Path(sigmaswarm.__file__).parents[2] / "hatch_build.py"
PROGRAM = """
import hashlib, json, sys
from pathlib import Path
import sigmaswarm as ss
from numba.core import event
from sigmaswarm import shipped
from sigmaswarm.filters.presets import DEFAULTS

shipped.KERNELS = Path(sys.argv[2])
drive = ss.read_drive(sys.argv[1])
with event.install_recorder("numba:compile") as compiled:
    run = ss.run_filter(drive, DEFAULTS)
    live = ss.LiveFilter(DEFAULTS, ss.initial_state(drive), nominal_interval=0.01)
    for i in range(1, 200):
        t = live.state.time + 0.01
        live.predict(t, (0.5, 0.1, 0.2))
        if i % 20 == 0:
            live.update(t, (i * 0.1, 0.3))
bits = [run.mean, run.covariance, live.state.mean, live.state.covariance]
print(json.dumps([[hashlib.sha256(b.tobytes()).hexdigest() for b in bits], len(compiled.buffer)]))
"""

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT or not HOOK.exists(), reason="nothing is compiled, or no checkout"
)


def codegen():
    return cpu_target.target_context.codegen()


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a build puts into a wheel, of planar5, for vectors of this machine's width."""
    file = tmp_path_factory.mktemp("wheel") / "kernels.zip"
    width = "8" if shipped.wide(codegen()) else "4"
    done = subprocess.run([sys.executable, HOOK, file, width, "planar5"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return file


def test_what_the_wheel_brings_has_the_bits_of_what_is_compiled(kernels: Path, tmp_path: Path):
    write_drive(make_drive(duration=24.0), tmp_path / "drive")

    def told(file: Path, **environment: str) -> tuple[list[str], int]:
        command = [sys.executable, "-c", PROGRAM, tmp_path / "drive", file]
        done = subprocess.run(
            command, capture_output=True, text=True, env=os.environ | environment, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    cache = str(tmp_path / "cache")
    compiled, _ = told(tmp_path / "nothing.zip")
    assert told(kernels, NUMBA_CACHE_DIR=cache) == [compiled, 0]
    assert told(tmp_path / "nothing.zip", NUMBA_CACHE_DIR=cache) == [compiled, 0], "it is kept"


def test_what_is_of_another_version_is_not_taken(kernels: Path, monkeypatch: pytest.MonkeyPatch):
    names = zipfile.ZipFile(kernels).namelist()
    own = [key for key in names if taken(kernels, key, monkeypatch)]
    assert own == names
    before = shipped.key_of("a kernel", (), codegen())
    for module in ("numba", "llvmlite"):
        with monkeypatch.context() as other:
            other.setattr(getattr(shipped, module), "__version__", "0.1")
            assert shipped.key_of("a kernel", (), codegen()) != before
    with monkeypatch.context() as other:
        other.setattr(shipped, "_sources", lambda: "others")
        assert shipped.key_of("a kernel", (), codegen()) != before
    assert not taken(kernels, before, monkeypatch)


@pytest.mark.parametrize("garbled", ["a bit", "the file", "no file"])
def test_what_is_garbled_is_not_taken(
    kernels: Path, tmp_path: Path, garbled: str, monkeypatch: pytest.MonkeyPatch
):
    (first, *_), file = zipfile.ZipFile(kernels).namelist(), tmp_path / "kernels.zip"
    if garbled == "a bit":
        content = bytearray(zipfile.ZipFile(kernels).read(first))
        content[len(content) // 2] ^= 4
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(first, bytes(content))
    elif garbled == "the file":
        file.write_bytes(kernels.read_bytes()[:1000])
    assert taken(kernels, first, monkeypatch)
    assert not taken(file, first, monkeypatch)


def taken(file: Path, key: str, monkeypatch: pytest.MonkeyPatch) -> bool:
    monkeypatch.setattr(shipped, "KERNELS", file)
    return shipped.brought(key, codegen()) is not None
