"""A short run of the fuzzer; `make fuzz MINUTES=30` is a long run."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fuzzing import records
from fuzzing.check import break_files, check, copied
from fuzzing.seeds import SEEDS
from importing.test_datasets import imu_csv
from sigmaswarm.drives.drive import Drive
from support import quickly


@pytest.mark.parametrize(
    "name", quickly([(name,) for name in SEEDS], lambda name: [*SEEDS].index(name) % 3 == 0)
)
@settings(
    max_examples=2,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(data=st.data())
def test_a_broken_log_is_refused_in_one_line_or_loses_only_what_is_broken(
    name: str, sound: dict[str, tuple[Path, Path, Drive]], imu: Path, tmp_path: Path, data: st.DataObject
):
    seed = SEEDS[name]
    if name not in sound:
        folder = imu.parent / name
        folder.mkdir()
        path = seed.write(folder)
        sound[name] = folder, path, seed.read(path, imu)
    folder, path, drive = sound[name]
    copy = copied(folder, path, tmp_path / "in")
    touched = break_files(data.draw, seed, tmp_path / "in")
    check(seed, copy, imu, drive, touched, tmp_path / "out")


@pytest.fixture(scope="module")
def sound() -> dict[str, tuple[Path, Path, Drive]]:
    """The sound logs that are written, by their readers: the folder, the log and its drive."""
    return {}


@pytest.fixture(scope="module")
def imu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An IMU's table, beside which fixes are read."""
    return imu_csv(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize(
    "name", quickly([(n,) for n in records.FOLDERS if n != "study"], lambda name: name != "evaluation")
)
def test_damaged_results_are_refused_in_one_line_or_read(name: str):
    findings, _ = records.fuzz(1, name, 5)
    assert not findings
