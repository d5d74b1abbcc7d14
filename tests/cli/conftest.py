"""Fixtures that call the command line in pytest's process."""

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from sigmaswarm.cli import main
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.simulation import simulate


@dataclass(frozen=True)
class Ended:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


Command = Callable[..., Ended]


@pytest.fixture
def sigmaswarm(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return a function that runs `sigmaswarm` with arguments; warnings are shown as to a user."""

    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["sigmaswarm", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "120")
        capsys.readouterr()
        with warnings.catch_warnings(), pytest.raises(SystemExit) as caught:
            warnings.simplefilter("default")
            warnings.filterwarnings("ignore", message="Cyclopts application invoked without tokens")
            main()
        out, err = capsys.readouterr()
        return Ended(int(caught.value.code or 0), out, err)

    return run


@pytest.fixture
def painted() -> None:
    """Request this in tests that read pictures."""


@pytest.fixture(autouse=True)
def no_pictures_by_default(request: pytest.FixtureRequest) -> None:
    if "painted" not in request.fixturenames:
        request.getfixturevalue("unpainted")


@pytest.fixture
def doctored() -> None:
    """Request this in tests of the doctor's warnings by `tune` and other commands; they take 25% of the time."""


@pytest.fixture(autouse=True)
def no_diagnosis_by_default(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "doctored" not in request.fixturenames:
        monkeypatch.setattr("sigmaswarm.cli.findings.warn_of_serious", lambda *_: [])


@pytest.fixture(scope="session")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two simulated drives."""
    folder = tmp_path_factory.mktemp("cli") / "drives"
    for run in range(2):
        drive = simulate("urban", run=run, duration=30.0, imu_rate=50.0, gps="white-1m")
        write_drive(drive, folder / drive.name)
    return folder


@pytest.fixture(scope="session")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of filter parameters."""
    path = tmp_path_factory.mktemp("tuned") / "tuning.toml"
    FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0), nominal_interval=0.02).save(
        path
    )
    return path


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to an empty working directory; return its path."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
