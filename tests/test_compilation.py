"""Machine code between processes: kept where it is safe, and never in the way of the run."""

import json
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

import sigmaswarm

PROGRAM = """
import json, warnings
from sigmaswarm.compilation import cached

@cached
def twice(x):
    return 2 * x

@cached(nogil=True)
def thrice(x):
    return 3 * x

with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    results = [twice(2.0), twice(3), thrice(2.0)]
hits = sum(sum(f.stats.cache_hits.values()) for f in (twice, thrice))
print(json.dumps({"results": results, "hits": hits, "said": [str(w.message) for w in said]}))
"""
COMPILED = 3
SIMULATE = ["simulate", "--out", "out", "--maneuver", "cruise", "--environment", "clear", "--runs", "1"]
RIGHT = [4.0, 6, 6.0]
SOURCES = Path(sigmaswarm.__file__).parents[1]
needs_modes = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners and modes here")


def run(
    folder: Path, cache: Path | None, *prefix: str, sources: Path = SOURCES, **environment: str
) -> dict[str, object]:
    (folder / "program.py").write_text(PROGRAM)
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    done = subprocess.run(
        [*prefix, sys.executable, "-B", str(folder / "program.py")],
        capture_output=True, text=True, check=False,
        env=kept | {"PYTHONPATH": str(sources)} | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["results"] == RIGHT
    return told


def files(cache: Path) -> list[Path]:
    return sorted(file for file in cache.rglob("*") if file.is_file())


def test_the_second_process_compiles_nothing(tmp_path: Path):
    cache = tmp_path / "cache"
    assert run(tmp_path, cache) == {"results": RIGHT, "hits": 0, "said": []}
    assert run(tmp_path, cache) == {"results": RIGHT, "hits": COMPILED, "said": []}
    assert {file.suffix for file in files(cache)} == {".nbi", ".nbc"}


@needs_modes
def test_the_folder_is_open_to_nobody_else(tmp_path: Path):
    usual = os.umask(0)
    try:
        run(tmp_path, tmp_path / "made" / "cache")
    finally:
        os.umask(usual)
    assert stat.S_IMODE((tmp_path / "made" / "cache" / "sigmaswarm").stat().st_mode) == 0o700


@needs_modes
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o720, 0o702])
def test_a_folder_that_others_can_write_is_not_used(tmp_path: Path, mode: int):
    cache = tmp_path / "cache"
    run(tmp_path, cache)
    before = [(file, file.read_bytes()) for file in files(cache)]
    (cache / "sigmaswarm").chmod(mode)
    for _ in range(2):
        told = run(tmp_path, cache)
        assert told["hits"] == 0
        (said,) = told["said"]
        assert f"{cache}/sigmaswarm is open to others" in said
        assert "set NUMBA_CACHE_DIR" in said
    assert [(file, file.read_bytes()) for file in files(cache)] == before


@needs_modes
def test_a_folder_that_others_can_exchange_is_not_used(tmp_path: Path):
    cache = tmp_path / "cache"
    run(tmp_path, cache)
    cache.chmod(0o777)
    assert run(tmp_path, cache)["hits"] == 0
    cache.chmod(0o1777)  # as /tmp
    assert run(tmp_path, cache)["hits"] == COMPILED


@needs_modes
def test_a_folder_of_somebody_else_is_not_used(tmp_path: Path):
    if os.getuid() != 0:
        pytest.skip("only root can give a folder away")
    cache = tmp_path / "cache"
    run(tmp_path, cache)
    os.chown(cache / "sigmaswarm", 65534, 65534)
    told = run(tmp_path, cache)
    assert (told["hits"], len(told["said"])) == (0, 1)  # type: ignore[arg-type]


def flipped(content: bytes, share: float) -> bytes:
    garbled = bytearray(content)
    garbled[int(share * (len(content) - 1))] ^= 0b100
    return bytes(garbled)


SPOILED = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:40],
    "half": lambda content: content[: len(content) // 2],
    "text": lambda content: b"not a pickle",
    **{f"bit at {share}": (lambda content, share=share: flipped(content, share)) for share in (0.3, 0.5, 0.7, 0.97)},
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("how", SPOILED)
def test_a_spoiled_file_is_compiled_anew(tmp_path: Path, how: str, suffix: str):
    cache = tmp_path / "cache"
    run(tmp_path, cache)
    for file in files(cache):
        if file.suffix == suffix:
            file.write_bytes(SPOILED[how](file.read_bytes()))
    told = run(tmp_path, cache)
    assert told["said"] == []
    spared = COMPILED - 1 if how.startswith("bit") and suffix == ".nbi" else 0  # the index's other entries
    assert told["hits"] <= spared  # type: ignore[operator]
    assert run(tmp_path, cache)["hits"] == COMPILED  # and is sound again


def _without_rights() -> list[str]:
    """A command in front of another one that leaves it no rights beyond those of files' modes."""
    if os.getuid() != 0:
        return []
    if not shutil.which("setpriv"):
        pytest.skip("root can write everywhere, and setpriv is not here to change that")
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@needs_modes
@pytest.mark.parametrize("variable", ["HOME", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_a_read_only_install_without_a_writable_home(tmp_path: Path, variable: str):
    home = tmp_path / "home"
    home.mkdir()
    install = tmp_path / "site-packages"
    shutil.copytree(
        SOURCES / "sigmaswarm", install / "sigmaswarm", ignore=shutil.ignore_patterns("__pycache__")
    )
    folders = [home, install, *(f for f in install.rglob("*") if f.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        environment = {"HOME": str(home), variable: str(home)}
        told = run(tmp_path, None, *_without_rights(), sources=install, **environment)
        command = "from sigmaswarm.cli import main; main()"
        done = subprocess.run(
            [*_without_rights(), sys.executable, "-B", "-c", command, *SIMULATE],
            capture_output=True, text=True, check=False, cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(install)} | environment,
        )  # fmt: skip
    finally:
        for folder in folders:
            folder.chmod(0o755)
    (said,) = told["said"]  # type: ignore[misc]
    assert "compiled filters are not kept" in said
    assert str(home) in said
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stderr.splitlines() if line.startswith("warning:")] == [f"warning: {said}"]
    assert files(home) == []
