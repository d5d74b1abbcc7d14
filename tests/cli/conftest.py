"""Call the command line in the process of the tests: printed text and exit code."""

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
    """How a command ended."""

    code: int
    out: str
    err: str


Command = Callable[..., Ended]


@pytest.fixture
def sigmaswarm(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run `sigmaswarm` with arguments; warnings are shown, as they are to a user."""

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
    """For tests that look at pictures."""


@pytest.fixture(autouse=True)
def unpainted_unless_painted(request: pytest.FixtureRequest) -> None:
    if "painted" not in request.fixturenames:
        request.getfixturevalue("unpainted")


@pytest.fixture
def doctored() -> None:
    """For tests that look at what `tune` and others warn of: the doctor takes a quarter of these tests' time."""


@pytest.fixture(autouse=True)
def undoctored_unless_doctored(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "doctored" not in request.fixturenames:
        monkeypatch.setattr("sigmaswarm.cli.findings.warn_of_serious", lambda *_: [])


@pytest.fixture(scope="session")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two simulated drives."""
    folder = tmp_path_factory.mktemp("cli") / "drives"
    for run in range(2):
        drive = simulate("urban", run=run, duration=30.0, imu_rate=50.0, gps="white-1m")
        write_drive(drive, folder / drive.name)
    return folder


@pytest.fixture(scope="session")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of filter parameters."""
    path = tmp_path_factory.mktemp("tuned") / "tuning.toml"
    FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0), nominal_interval=0.02).save(
        path
    )
    return path


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
