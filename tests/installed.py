"""Test a wheel as a user would: in an empty environment outside the checkout, with each installed Python.

    python tests/installed.py dist
    python tests/installed.py dist --this-python

Run it manually or with `make dist-check`. It installs all packages and runs the demo, which takes minutes.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

PYTHONS = ("3.11", "3.12", "3.13")
CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
MUST_HOLD = (
    "sigmaswarm/py.typed",
    "sigmaswarm_carla/__main__.py",
    "sigmaswarm/exports/templates/ins_gps.c.in",
    "sigmaswarm/reports/assets/page.html",
)


def contents_wrong(wheel: Path) -> list[str]:
    """Return the missing and the superfluous files of a wheel."""
    names = zipfile.ZipFile(wheel).namelist()
    lacking = [f"lacks {name}" for name in MUST_HOLD if name not in names]
    folders = {name.partition("/")[0] for name in names}
    own = {"sigmaswarm", "sigmaswarm_carla"}
    stray = [f"has {name}" for name in folders - own if not name.startswith("sigmaswarm-")]
    return lacking + stray + [f"has {name}" for name in names if "test" in Path(name).name]


def tried(python: str, wheel: Path) -> str:
    """Install the wheel and run its commands with one Python; return the result in one line."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
        environment["NUMBA_CACHE_DIR"] = str(folder / "cache")  # the first run of a user has no cache

        def run(*command: str | Path) -> tuple[str, float]:
            begun = time.perf_counter()
            done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(
                    f"{python}: {' '.join(map(str, command))} failed:\n{done.stdout}{done.stderr}"
                )
            return done.stdout, time.perf_counter() - begun

        run(python, "-m", "venv", folder / "venv")
        scripts = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        inside = scripts / "python"
        _, installed = run(
            inside, "-m", "pip", "install", "--quiet", "--constraint", CONSTRAINTS, wheel.resolve()
        )
        version, _ = run(scripts / "sigmaswarm", "--version")
        again, _ = run(inside, "-m", "sigmaswarm", "--version")
        place, _ = run(inside, "-c", "import sigmaswarm; print(sigmaswarm.__file__)")
        assert str(folder) in str(Path(place.strip())), f"another sigmaswarm is used: {place}"
        assert version == again, (version, again)
        assert f"-{version.strip()}-" in wheel.name, (version, wheel.name)
        shown, demo = run(scripts / "sigmaswarm", "demo", "--out", "demo")
        assert "default filter of tune" in shown, shown
        best = Path("demo") / "best" / "honest-default.toml"
        run(scripts / "sigmaswarm", "export", best, "--to", "c99", "--out", "filter-c")
        assert (folder / "demo" / "page.html").stat().st_size > 1e6
        assert (folder / "filter-c" / "ins_gps.c").exists()
        return f"{version.strip()}: installed in {installed:.0f} s, demo in {demo:.0f} s"


def found(version: str) -> str | None:
    """Find a Python of a version, on the path or in pyenv's folder; a command on the path may be a shim that fails."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    named = [f"python{version}", *map(str, sorted(kept.glob(f"{version}.*/bin/python"), reverse=True))]
    for python in filter(shutil.which, named):
        if not subprocess.run([python, "--version"], capture_output=True).returncode:
            return python
    return None


def main() -> None:
    """Print the result for each Python."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dist", type=Path, help="folder with the wheel")
    parser.add_argument("--this-python", action="store_true", help="only the Python that runs this")
    asked = parser.parse_args()
    (wheel,) = asked.dist.glob("*.whl")
    if wrong := contents_wrong(wheel):
        raise SystemExit(f"{wheel.name} {'; '.join(wrong)}")
    for file in sorted(asked.dist.iterdir()):
        print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB")
    if asked.this_python:
        print(tried(sys.executable, wheel))
        return
    for version in PYTHONS:
        python = found(version)
        print(
            f"Python {version}: {tried(python, wheel) if python else 'SKIPPED, it is not there'}", flush=True
        )


if __name__ == "__main__":
    main()
