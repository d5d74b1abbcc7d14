"""The cache of machine code: it is used only where it is safe, and does not change results."""

import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

import sigmaswarm
from support import quickly

PROGRAM = """
import json, logging, sys, warnings
from numba import config
from sigmaswarm import compilation
from sigmaswarm.compilation import cached

logging.basicConfig(level="INFO", format="%(message)s")

def told():
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
    return {"results": results, "hits": hits, "said": [str(w.message) for w in said]}

each = []
for folder in sys.argv[1:] or [config.CACHE_DIR]:
    config.CACHE_DIR = folder
    compilation._folder.cache_clear()
    each.append(told())
print(json.dumps(each))
"""
COMPILED = 3
SIMULATE = ["simulate", "--out", "out", "--maneuver", "cruise", "--environment", "clear", "--runs", "1"]
RIGHT = [4.0, 6, 6.0]
SOURCES = Path(sigmaswarm.__file__).parents[1]
WRITABLE, EXCHANGEABLE = ("777", "770", "720", "702"), ("p-777", "p-1777")
"""Modes of a cache, and of its parent folder."""
Looked = dict[str, tuple[Path, dict[str, object]]]
needs_modes = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners and modes here")


def run(folder: Path, cache: Path) -> dict[str, object]:
    """Run the program in a process with the given cache; return its report."""
    (told,) = _process(folder, NUMBA_CACHE_DIR=str(cache))
    return told


def _process(
    folder: Path, *prefix: str, sources: Path = SOURCES, caches: Iterable[Path] = (), **environment: str
) -> list[dict[str, object]]:
    """Return one process's report on each cache: results, cache hits, warnings; and the log of the process."""
    program = folder / "program.py"
    if not program.exists():  # its modification time is part of the cache's key
        program.write_text(PROGRAM)
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    done = subprocess.run(
        [*prefix, sys.executable, "-B", str(program), *map(str, caches)],
        capture_output=True, text=True, check=False,
        env=kept | {"PYTHONPATH": str(sources)} | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    each = json.loads(done.stdout)
    assert all(told.pop("results") == RIGHT for told in each)
    return [told | {"logged": done.stderr} for told in each]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """Return a folder with a program and a full cache of it, and the program's report."""
    folder = tmp_path_factory.mktemp("sound")
    return folder, run(folder, folder / "cache")


@pytest.fixture(scope="module")
def sound(first: tuple[Path, dict[str, object]]) -> Path:
    return first[0]


def files(cache: Path) -> list[Path]:
    return sorted(file for file in cache.rglob("*") if file.is_file())


@pytest.fixture(scope="module")
def looked(sound: Path, tmp_path_factory: pytest.TempPathFactory) -> Looked:
    """Return copies of the cache with different modes and owners, an empty folder, and the report on each."""
    folder = tmp_path_factory.mktemp("looked")
    caches = {
        name: Path(shutil.copytree(sound / "cache", folder / name))
        for name in (*WRITABLE, *EXCHANGEABLE, "owner")
    }
    for name in WRITABLE:
        (caches[name] / "sigmaswarm").chmod(int(name, 8))
    for name in EXCHANGEABLE:
        caches[name].chmod(int(name[2:], 8))
    if os.getuid() == 0:  # only root can change the owner of a folder
        os.chown(caches["owner"] / "sigmaswarm", 65534, 65534)
    caches["new"] = folder / "made" / "cache"
    usual = os.umask(0)
    try:
        each = _process(sound, caches=caches.values())
    finally:
        os.umask(usual)
    return {name: (caches[name], told) for name, told in zip(caches, each, strict=True)}


def test_the_second_process_compiles_nothing(first: tuple[Path, dict[str, object]]):
    folder, told = first
    assert (told["hits"], told["said"]) == (0, [])
    assert run(folder, folder / "cache") == {"hits": COMPILED, "said": [], "logged": ""}
    assert {file.suffix for file in files(folder / "cache")} == {".nbi", ".nbc"}


def test_that_something_is_compiled_is_told_once(first: tuple[Path, dict[str, object]]):
    folder, told = first
    said = f"compiling filters, once on this machine: about ten seconds (cached in {folder / 'cache'}/sigmaswarm)\n"
    assert told["logged"] == said


@needs_modes
def test_the_folder_is_open_to_nobody_else(looked: Looked):
    cache, _ = looked["new"]
    assert stat.S_IMODE((cache / "sigmaswarm").stat().st_mode) == 0o700


@needs_modes
def test_a_folder_that_others_can_write_is_not_used(looked: Looked, sound: Path):
    before = {file.relative_to(sound / "cache"): file.read_bytes() for file in files(sound / "cache")}
    for cache, told in (looked[name] for name in WRITABLE):
        assert told["hits"] == 0
        (said,) = told["said"]
        assert f"other users have access to {cache}/sigmaswarm" in said
        assert "set NUMBA_CACHE_DIR" in said
        assert {file.relative_to(cache): file.read_bytes() for file in files(cache)} == before


@needs_modes
def test_a_folder_that_others_can_exchange_is_not_used(looked: Looked):
    assert [looked[name][1]["hits"] for name in EXCHANGEABLE] == [0, COMPILED]


@needs_modes
def test_a_folder_of_somebody_else_is_not_used(looked: Looked):
    if os.getuid() != 0:
        pytest.skip("only root can give a folder away")
    _, told = looked["owner"]
    assert (told["hits"], len(told["said"])) == (0, 1)


def flipped(content: bytes, share: float) -> bytes:
    garbled = bytearray(content)
    garbled[int(share * (len(content) - 1))] ^= 0b100
    return bytes(garbled)


SPOILED = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:40],
    "half": lambda content: content[: len(content) // 2],
    "text": lambda content: b"not a pickle",
    **{f"bit at {share}": (lambda content, share=share: flipped(content, share)) for share in (0.5, 0.97)},
}  # fmt: skip


CASES = [(how, suffix) for how in SPOILED for suffix in (".nbi", ".nbc")]


@pytest.fixture(scope="module")
def spoiled(
    sound: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[tuple[str, str], list[dict[str, object]]]:
    """Return the reports on each spoiled cache from two successive runs."""
    folder = tmp_path_factory.mktemp("spoiled")
    caches = [shutil.copytree(sound / "cache", folder / str(i)) for i in range(len(CASES))]
    for (how, suffix), cache in zip(CASES, caches, strict=True):
        for file in files(cache):
            if file.suffix == suffix:
                file.write_bytes(SPOILED[how](file.read_bytes()))
    each = _process(sound, caches=[*caches, *caches])
    return {
        case: list(told) for case, *told in zip(CASES, each[: len(CASES)], each[len(CASES) :], strict=True)
    }


@pytest.mark.parametrize(("how", "suffix"), CASES)
def test_a_spoiled_file_is_compiled_anew(
    spoiled: dict[tuple[str, str], list[dict[str, object]]], how: str, suffix: str
):
    told, again = spoiled[how, suffix]
    assert told["said"] == []
    spared = COMPILED - 1 if how.startswith("bit") and suffix == ".nbi" else 0  # other entries are intact
    assert told["hits"] <= spared
    assert again["hits"] == COMPILED  # the cache has been repaired


def _without_rights() -> list[str]:
    """Return a command prefix that removes all privileges except the permissions of file modes."""
    if os.getuid() != 0:
        return []
    if not shutil.which("setpriv"):
        pytest.skip("root can write everywhere, and setpriv is not here to change that")
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@needs_modes
@pytest.mark.parametrize(
    ("variable", "command"),
    quickly(
        [("HOME", False), ("NUMBA_CACHE_DIR", False), ("XDG_CACHE_HOME", False), ("HOME", True)],
        lambda variable, command: variable == "HOME" and not command,
    ),
)
def test_a_read_only_install_without_a_writable_home(tmp_path: Path, variable: str, command: bool):
    home = tmp_path / "home"
    home.mkdir()
    install = tmp_path / "site-packages"
    shutil.copytree(
        SOURCES / "sigmaswarm", install / "sigmaswarm", ignore=shutil.ignore_patterns("__pycache__")
    )
    folders = [home, install, *(f for f in install.rglob("*") if f.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    environment, done = {"HOME": str(home), variable: str(home)}, None
    try:
        (told,) = _process(tmp_path, *_without_rights(), sources=install, **environment)
        if command:  # everything is compiled
            program = "from sigmaswarm.cli import main; main()"
            done = subprocess.run(
                [*_without_rights(), sys.executable, "-B", "-c", program, *SIMULATE],
                capture_output=True, text=True, check=False, cwd=tmp_path,
                env=os.environ | {"PYTHONPATH": str(install)} | environment,
            )  # fmt: skip
    finally:
        for folder in folders:
            folder.chmod(0o755)
    (said,) = told["said"]
    assert "compiled filters are not cached" in said
    assert str(home) in said
    if done is not None:
        assert done.returncode == 0, done.stderr
        warned = [line for line in done.stderr.splitlines() if line.startswith("warning:")]
        assert warned == [f"warning: {said}"]
    assert files(home) == []


def test_no_function_has_numba_s_own_cache():
    """Numba stores its cache next to the sources; these may be writable for others, or read-only."""
    sources = Path(sigmaswarm.__file__).parent.rglob("*.py")
    assert [str(file) for file in sources if "cache=True" in file.read_text()] == []
