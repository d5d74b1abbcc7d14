"""Files of earlier versions are read, and give the numbers that those versions computed from them.

`corpus/README.md` describes the archives and how they were made.
"""

import csv
import json
import math
import platform
import shutil
import sys
import tarfile
import warnings
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite import binding as llvm

import sigmaswarm
from sigmaswarm.cli import main
from sigmaswarm.filters import starts
from support import quickly

CORPUS = Path(__file__).parent / "corpus"
VERSION = "0.3.0"
WORLD_TOLERANCE = 1e-8  # m: another version of the library may convert latitude and longitude differently
# Initial states differ in their last bits, since sums depend on the vector width; the corpus was made with AVX-512.
TOLERANCE = 1e-12 if llvm.get_host_cpu_features().get("avx512f") else 1e-9


def _expected() -> dict[str, Any]:
    with tarfile.open(CORPUS / f"{VERSION}.tar.xz") as archive:
        file = archive.extractfile("expected.json")
        assert file is not None
        return json.load(file)


EXPECTED = _expected()
TUNINGS = sorted(EXPECTED["tunings"])
EVALUATIONS = (
    "against",
    "against-file",
    "no-truth",
    "plain",
    "smooth",
    "swarm",
    "two-drives",
    "world",
    "world-no-truth",
)


def _same_libraries() -> bool:
    import numba
    import scipy

    here = {"python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__}
    here |= {"scipy": scipy.__version__, "machine": platform.machine()}
    return EXPECTED["made_with"] == here


same_libraries = pytest.mark.skipif(
    not _same_libraries(), reason="other libraries than those that made the corpus"
)


@pytest.fixture(autouse=True)
def level_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start tilted12 without evidence about tilts, as version 0.3.0 did."""
    monkeypatch.setattr(starts, "add_tilt_evidence", lambda *_: None)


@pytest.fixture(scope="session")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    with tarfile.open(CORPUS / f"{VERSION}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.fixture
def corpus(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use the unpacked archive as the current folder; tests do not write into it."""
    monkeypatch.chdir(unpacked)
    return unpacked


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs a command in this process, checks success and returns its output."""

    def run(*words: object) -> str:
        monkeypatch.setattr(sys, "argv", ["sigmaswarm", *map(str, words)])
        capsys.readouterr()
        with warnings.catch_warnings(), pytest.raises(SystemExit) as ended:
            warnings.simplefilter("ignore")
            main()
        out, err = capsys.readouterr()
        assert not ended.value.code, err
        return out

    return run


def assert_equal(found: Any, expected: Any, tolerance: float = TOLERANCE, where: str = "") -> None:
    """Compare numbers in nested dicts and lists; new keys are allowed."""
    if isinstance(expected, dict):
        for key, value in expected.items():
            assert key in found, f"{where}.{key} is gone"
            assert_equal(found[key], value, tolerance, f"{where}.{key}")
    elif isinstance(expected, list):
        assert len(found) == len(expected), where
        for i, value in enumerate(expected):
            assert_equal(found[i], value, tolerance, f"{where}[{i}]")
    elif isinstance(expected, float) and not isinstance(found, str):
        both_nan = math.isnan(expected) and math.isnan(found)
        assert both_nan or abs(found - expected) <= tolerance * max(1.0, abs(expected)), (
            f"{where}: {found} {expected}"
        )
    else:
        assert found == expected, where


def assert_same_numbers(new: Path, old: Path, *, changed: tuple[str, ...] = ()) -> None:
    """Compare the columns of two CSV files, except those with an ending in ``changed``; new columns are allowed."""
    after, before = (list(csv.DictReader(path.read_text().splitlines())) for path in (new, old))
    assert len(after) == len(before)
    for row, was in zip(after, before, strict=True):
        for name, cell in was.items():
            if name.endswith(changed):
                continue
            try:
                assert_equal(float(row[name]), float(cell), where=name)
            except ValueError:
                assert row[name] == cell, name


# --- drives -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "folder",
    quickly(
        [(f,) for f in sorted(EXPECTED["drives"])], lambda f: sorted(EXPECTED["drives"]).index(f) % 3 == 0
    ),
)
def test_drives_are_read_and_diagnosed_as_before(corpus: Path, folder: str):
    expected = EXPECTED["drives"][folder]
    drive = sigmaswarm.read_drive(folder)
    tables = {"imu": drive.imu, "gps": drive.gps, "truth": drive.truth, "odometer": drive.odometer}
    sums = {
        f"{role}.{field.name}": float(getattr(table, field.name).sum())
        for role, table in tables.items()
        if table is not None
        for field in fields(table)
        if getattr(table, field.name) is not None
    }
    assert drive.frame == expected["frame"]
    assert_equal(sums, expected["sums"], WORLD_TOLERANCE if drive.frame == "wgs84" else TOLERANCE)
    codes = [
        code for code in expected["findings"] if code != "gravity" or "unseen-yaw" not in expected["findings"]
    ]
    assert (
        sorted(finding.code for finding in sigmaswarm.diagnose(drive).findings) == codes
    )  # without a gyro, no axes are detected


@pytest.mark.parametrize("recipe", ["csv", "mounted"])
def test_recipes_give_the_same_drives(corpus: Path, tmp_path: Path, command: Callable[..., str], recipe: str):
    out = tmp_path / recipe
    command(
        "import", "logs/imu.csv", "--gps", "logs/gps.csv", "--recipe", f"recipes/{recipe}.toml", "--out", out
    )
    new, old = sigmaswarm.read_drive(out), sigmaswarm.read_drive(f"imported/{recipe}")
    for role in ("imu", "gps"):
        for field in fields(getattr(old, role)):
            was, now = (getattr(getattr(d, role), field.name) for d in (old, new))
            if was is not None:
                np.testing.assert_allclose(now, was, rtol=0, atol=WORLD_TOLERANCE, err_msg=field.name)


# --- tunings ----------------------------------------------------------------------------------------------------------


def test_every_tuning_is_read(corpus: Path):
    assert all(sigmaswarm.FilterParameters.load(f"tunings/{name}") for name in TUNINGS)


@same_libraries
@pytest.mark.parametrize(
    "name", quickly([(name,) for name in TUNINGS], lambda name: TUNINGS.index(name) % 6 == 0)
)
def test_tunings_score_and_estimate_as_before(corpus: Path, name: str):
    expected = EXPECTED["tunings"][name]
    drive = sigmaswarm.read_drive(f"drives/{expected['drive']}")
    parameters = sigmaswarm.FilterParameters.load(f"tunings/{name}")
    estimate = sigmaswarm.run_filter(drive, parameters)
    found = {
        "score": asdict(sigmaswarm.evaluate(drive, parameters).scores[drive.name]["tuned"]),
        "last_mean": estimate.mean[-1].tolist(),
        "sum_of_means": estimate.mean.sum(axis=0).tolist(),
        "last_variances": np.diag(estimate.covariance[-1]).tolist(),
    }
    del expected["drive"]
    assert_equal(found, expected, 1e-6 if drive.frame == "wgs84" else TOLERANCE, name)


@pytest.mark.parametrize(
    "name",
    quickly(
        [
            (n,)
            for n in ("default", "default-no-truth", "paper", "worst-validation-margin", "../custom/track")
        ],
        lambda name: name in ("default", "worst-validation-margin", "../custom/track"),
    ),
)
def test_pages_of_tunings(corpus: Path, tmp_path: Path, command: Callable[..., str], name: str):
    command("report", f"tunings/{name}", "--out", tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size > 10_000


def test_tunings_are_evaluated_run_and_exported_by_the_command_line(
    corpus: Path, tmp_path: Path, command: Callable[..., str], unpainted: None
):
    scores = json.loads(command("evaluate", "tunings/planar8", "drives/town-2", "--json", "--trust-log"))
    expected = EXPECTED["tunings"]["planar8"]["score"]
    assert scores["mean"]["tuned"]["position_rmse_m"] == pytest.approx(expected["position_rmse"], rel=1e-9)
    command("run", "tunings/planar8", "drives/town-2", "--out", tmp_path / "plain.csv")
    new, old = (
        np.genfromtxt(p, delimiter=",", names=True) for p in (tmp_path / "plain.csv", "estimates/plain.csv")
    )
    for column in ("t", "x", "y", "vx", "vy", "theta"):
        np.testing.assert_allclose(new[column], old[column], rtol=0, atol=1e-9)
    for target in ("filterpy", "c99", "robot_localization"):
        command("export", "tunings/planar5", "--to", target, "--out", tmp_path / target)
    command("evaluate", "tunings/planar8", "drives/town-2", "--against", "filters/own.toml", "--trust-log")


def test_a_swarm_settled_filter_is_read(corpus: Path):
    (file,) = Path("estimates").glob("*.swarm.toml")
    assert sigmaswarm.FilterParameters.load(file).model == "planar5"


@same_libraries
@pytest.mark.parametrize("optimizer", ["de", "pso", "cma-es"])
def test_interrupted_tunings_end_in_the_same_filter(
    corpus: Path, tmp_path: Path, optimizer: str, unpainted: None
):
    out = tmp_path / optimizer
    shutil.copytree(f"interrupted/{optimizer}", out)
    assert list(out.glob("checkpoint-*.npz"))
    drives = [sigmaswarm.read_drive(f"drives/town-{i}") for i in range(2)]
    options: dict[str, Any] = {
        "model": "planar5",
        "objective": "truth-rmse",
        "particles": 4,
        "generations": 6,
    }
    options |= {"trials": 2, "seed": 3, "optimizer": optimizer}
    without = tmp_path / "without-checkpoint"
    shutil.copytree(out, without)
    for checkpoint in without.glob("checkpoint-*.npz"):
        checkpoint.unlink()  # the trial starts again, as in version 0.3.0, whose first generation is uniform
    tuning = sigmaswarm.tune(drives, out=out, resume=True, **options)
    assert sigmaswarm.tune(drives, out=without, resume=True, **options).parameters == tuning.parameters
    whole = sigmaswarm.FilterParameters.load(f"uninterrupted/{optimizer}")
    assert tuning.parameters == whole
    assert sigmaswarm.FilterParameters.load(out) == whole


# --- evaluations, comparisons, studies, networks ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", quickly([(name,) for name in EVALUATIONS], lambda name: name in ("against", "no-truth"))
)
def test_pages_of_evaluations(
    corpus: Path, tmp_path: Path, command: Callable[..., str], unpainted: None, name: str
):
    command("report", f"evaluations/{name}", "--out", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    scores = json.loads(Path(f"evaluations/{name}/scores.json").read_text())
    for drive in scores["drives"]:
        assert drive in page


def test_pages_of_studies(corpus: Path, tmp_path: Path, command: Callable[..., str]):
    command("report", "study", "--out", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    for method in json.loads(Path("study/results.json").read_text())["methods"].values():
        assert method.replace("'", "&#x27;") in page or method in page


@same_libraries
def test_comparisons_are_gone_on_with(
    corpus: Path, tmp_path: Path, command: Callable[..., str], unpainted: None
):
    out = tmp_path / "comparison"
    shutil.copytree("comparison", out)
    shutil.rmtree(out / "runs/de-log10-003")
    (out / "comparison.csv").unlink()
    command(
        *("compare", "drives/town-0", "drives/town-1", "--validation", "drives/town-2", "--model", "planar5"),
        *[
            "--optimizers",
            "pso",
            "de",
            "pso:polish=2",
            "--particles",
            "3",
            "--generations",
            "2",
            "--trials",
            "2",
        ],
        *("--workers", "1", "--out", out, "--resume"),
    )
    intervals = ("_low", "_high")  # intervals were too narrow in 0.3.0
    assert_same_numbers(out / "comparison.csv", Path("comparison/comparison.csv"), changed=intervals)


@pytest.mark.long
@same_libraries
def test_studies_are_gone_on_with(corpus: Path, tmp_path: Path, command: Callable[..., str], unpainted: None):
    out = tmp_path / "study"
    shutil.copytree("study", out)
    shutil.rmtree(out / "trials/honest-pso-ekf/trial-001")
    (out / "results.json").unlink()
    command("study", "--out", out, "--resume", "--workers", "1")
    new, old = (json.loads((folder / "results.json").read_text()) for folder in (out, Path("study")))
    assert_equal(new, old)


@same_libraries
@pytest.mark.parametrize(
    "network", quickly([(n,) for n in sorted(EXPECTED["learned"])], lambda network: network == "outage-lstm")
)
def test_networks_score_as_before(corpus: Path, command: Callable[..., str], network: str):
    found = json.loads(command("evaluate", f"learned/{network}", "drives/town-2", "--json", "--trust-log"))
    # the baseline, "untuned", was different in 0.3.0
    expected = {method: of for method, of in EXPECTED["learned"][network].items() if method != "untuned"}
    assert_equal(found["mean"], expected, where=network)


def test_a_reference_is_read(corpus: Path):
    truth = sigmaswarm.read_drive("reference").truth
    assert truth is not None and truth.std_x is not None
