"""Damaged records: one line that names the file. A folder of results is replaced as a whole."""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exported import export_filter
from fuzzing.check import limited
from fuzzing.records import record_network
from sigmaswarm import FilterParameters, evaluate, tune
from sigmaswarm.cli.simulate import _require_made_with
from sigmaswarm.datasets.cluster import _scheduler
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.compare import compare
from sigmaswarm.experiments.comparison import Comparison, Outcome
from sigmaswarm.files import atomic_file, staged_files, write_atomically
from sigmaswarm.learned.folder import load_learned
from sigmaswarm.record_files import content_if_readable, load_record
from sigmaswarm.reports.compare import save_comparison
from sigmaswarm.reports.evaluation import save_evaluation
from sigmaswarm.reports.read import read_report
from sigmaswarm.scoring.records import EvaluationRecord, ScoresRecord
from sigmaswarm.scoring.tracks import load_tracks
from sigmaswarm.tuning.record import TuningRecord, history_of, load_history
from sigmaswarm.tuning.store import ResultFolder, finished_trial
from support import file_contents, make_drive, no_pictures

pytestmark = pytest.mark.usefixtures("undiagnosed")

TEXTS: dict[str, bytes] = {
    "empty": b"",
    "no text": b"\xff\xfe\x00",
    "nested": b"[" * 100_000,
    "nested keys": b'{"a":' * 50_000,
    "digits": b'{"cost": ' + b"9" * 5000 + b"}",
    "a text": b'"x"',
    "a list": b"[1, 2]",
    "null": b"null",
    "no keys": b"{}",
    "zeros": b"\0" * 1000,
    "toml": b"x = " + b"[" * 3000,
    "large": b" " * (70 << 20),
}
RECORDS: dict[str, Callable[[Path], object]] = {
    "tuning.toml": FilterParameters.load,
    "scores.json": lambda path: load_record(ScoresRecord, path),
    "evaluation.json": lambda path: load_record(EvaluationRecord, path),
    "run.json": Outcome.read,
    "result.json": lambda path: finished_trial(path.parent.parent, 0),
    "history.npz": lambda path: finished_trial(path.parent.parent, 0),
    "tracks.npz": load_tracks,
    "convergence.csv": load_history,
}


@pytest.mark.parametrize("how", TEXTS)
@pytest.mark.parametrize("name", RECORDS)
def test_a_damaged_record_is_named(name: str, how: str, tmp_path: Path):
    folder = tmp_path / "trial-000"
    folder.mkdir()
    (folder / "result.json").write_text('{"cost": 1.0, "counts": {"evaluations": 1, "failures": 0}}')
    (folder / name).write_bytes(TEXTS[how])
    with pytest.raises(InputError, match=name.replace(".", r"\.")) as raised:
        RECORDS[name](folder / name)
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 1000


GOOD = {"point": np.zeros(3), "best": np.ones(2), "median": np.ones(2), "steps": np.ones(2, int)}
HISTORIES = {
    "no best": {k: v for k, v in GOOD.items() if k != "best"},
    "more": GOOD | {"zzz": np.ones(2)},
    "lengths": GOOD | {"best": np.ones(3)},
    "texts": GOOD | {"best": np.array(["a", "b"])},
    "a number": GOOD | {"steps": np.array(1)},
    "nothing": {k: v[:0] for k, v in GOOD.items()},
}
RESULTS = [
    {},
    {"cost": "x", "counts": {"evaluations": 1, "failures": 0}},
    {"cost": 1.0, "counts": {"evaluations": 1}},
    {"cost": 1.0, "counts": [1, 2]},
    {"cost": 1.0, "counts": {"evaluations": 1, "failures": 0}, "zzz": 1},
    {"cost": None, "counts": {"evaluations": 1, "failures": 0}},
]


@pytest.mark.parametrize("broken", [*HISTORIES, *range(len(RESULTS))])
def test_a_trial_that_is_no_trial(broken: str | int, tmp_path: Path):
    folder = tmp_path / "trial-000"
    folder.mkdir()
    sound = {"cost": np.inf, "counts": {"evaluations": 1, "failures": 0}}
    (folder / "result.json").write_text(json.dumps(sound))
    np.savez(folder / "history.npz", **GOOD)
    assert finished_trial(tmp_path, 0)
    if isinstance(broken, str):
        np.savez(folder / "history.npz", **HISTORIES[broken])
    else:
        (folder / "result.json").write_text(json.dumps(RESULTS[broken]))
    name = "history.npz" if isinstance(broken, str) else "result.json"
    with pytest.raises(InputError, match=f"{name}: .*delete .*trial-000 to redo this trial"):
        finished_trial(tmp_path, 0)


@pytest.mark.parametrize("fails_at", range(1, 6))
def test_files_take_their_places_together_or_not_at_all(
    fails_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "out"
    (folder / "sub").mkdir(parents=True)
    for name in ("a", "b", "sub/c", "mine"):
        (folder / name).write_text("old")
    before, moved, rename = file_contents(folder), 0, Path.rename

    def failing(path: Path, target: Path) -> Path:
        nonlocal moved
        moved += 1
        if moved == fails_at:
            raise OSError(28, "No space left on device", str(path))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(InputError, match="free some space"), staged_files(folder) as new:
        (new / "sub").mkdir()
        for name in ("a", "b", "sub/c"):
            write_atomically(new / name, "new")
    assert file_contents(folder) == before


@pytest.mark.parametrize("killed_at", range(1, 6))
def test_a_kill_between_two_files_is_undone_by_the_next_run(killed_at: int, tmp_path: Path):
    folder = tmp_path / "out"
    folder.mkdir()
    for name in "abc":
        (folder / name).write_text("old")
    before = file_contents(folder)
    if (child := os.fork()) == 0:
        rename, moved = Path.rename, 0

        def dying(path: Path, target: Path) -> Path:
            nonlocal moved
            moved += 1
            if moved == killed_at:
                os._exit(9)
            return rename(path, target)

        Path.rename = dying
        with staged_files(folder) as new:
            for name in "abc":
                write_atomically(new / name, "new")
        os._exit(0)
    os.waitpid(child, 0)
    write_atomically(folder / "another", "x")
    assert file_contents(folder) == before | {"another": b"x"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two evaluations of one drive, by two tunings."""
    root, drive = tmp_path_factory.mktemp("evaluations"), make_drive(duration=20.0, imu_rate=50.0)
    for seed in (0, 1):
        tuning = tune(drive, particles=4, generations=5, seed=seed)
        tuning.save(root / f"{seed}.toml")
        with no_pictures():
            save_evaluation(evaluate(drive, tuning.parameters), root / str(seed), root / f"{seed}.toml")
    return root / "0", root / "1"


@pytest.mark.parametrize("name", ["scores.json", "tracks.npz", "tuning.toml", "evaluation.json"])
def test_report_refuses_a_file_of_another_evaluation(name: str, folders: tuple[Path, Path]):
    one, other = folders
    read_report(one)
    sound = (one / name).read_bytes()
    (one / name).write_bytes((other / name).read_bytes())
    try:
        with pytest.raises(InputError, match=r"does not belong to evaluation\.json"):
            read_report(one)
    finally:
        (one / name).write_bytes(sound)


def test_an_export_over_an_older_one_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    p = FilterParameters(0.5, 2.0, 1.0, (1e-4,) * 5, (1.0, 1.0), nominal_interval=0.01)
    export_filter(p, "c99", tmp_path / "c")
    before = file_contents(tmp_path / "c")
    written = 0

    def full(path: Path, content: bytes | str) -> None:
        nonlocal written
        written += 1
        if written == 4:
            raise InputError(f"{path}: can't be written (No space left on device)")
        path.write_text(str(content))

    monkeypatch.setattr("sigmaswarm.exports.targets.write_atomically", full)
    other = FilterParameters(0.5, 2.0, 1.0, (1e-3,) * 5, (2.0, 1.0), nominal_interval=0.01)
    with pytest.raises(InputError, match=str(tmp_path / "c")):
        export_filter(other, "c99", tmp_path / "c")
    assert file_contents(tmp_path / "c") == before


def test_a_config_that_is_no_table(folders: tuple[Path, Path], tmp_path: Path):
    text = "config = 3\n" + (folders[0] / "tuning.toml").read_text().split("[config]")[0]
    (tmp_path / "tuning.toml").write_text(text)
    with pytest.raises(InputError, match=r"tuning\.toml: config: "):
        load_record(TuningRecord, tmp_path / "tuning.toml")


SHAPES = {
    "another shape": lambda a: a.reshape(-1, 1),
    "longer": lambda a: np.append(a, a),
    "a number": lambda a: np.array(3.0),
    "texts": lambda a: a.astype(str),
    "nothing": lambda a: a.ravel()[:0],
}


DRIVE = make_drive(duration=20.0, imu_rate=50.0)
INTERRUPTED = {"particles": 4, "generations": 3, "optimizer": "de"}


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tuning that ended after its first generation."""
    folder = tmp_path_factory.mktemp("interrupted")

    def stop(progress: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(DRIVE, out=folder, progress=stop, **INTERRUPTED)
    return folder


@pytest.mark.parametrize("how", SHAPES)
@pytest.mark.parametrize("name", ["first.positions", "first.members", "best", "global_best"])
def test_a_checkpoint_of_another_shape_is_named(name: str, how: str, interrupted: Path, tmp_path: Path):
    folder = shutil.copytree(interrupted, tmp_path / "out")
    path = folder / "checkpoint-000.npz"
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays[name] = SHAPES[how](arrays[name])
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"checkpoint-000\.npz: .*; delete it to redo this trial"):
        tune(DRIVE, out=folder, resume=True, **INTERRUPTED)


@pytest.mark.parametrize("how", [*SHAPES, "gone", "nan"])
@pytest.mark.parametrize("name", ["input", "head_bias", "center"])
def test_weights_of_another_shape_are_named(name: str, how: str, tmp_path: Path):
    record_network(tmp_path)
    assert load_learned(tmp_path)
    with np.load(tmp_path / "weights.npz") as file:
        arrays = {key: file[key] for key in file.files}
    old = arrays.pop(name)
    if how != "gone":
        arrays[name] = np.full(old.shape, np.nan) if how == "nan" else SHAPES[how](old)
    if how == "texts":
        arrays[name] = np.full(old.shape, "x")
    np.savez(tmp_path / "weights.npz", **arrays)
    with pytest.raises(
        InputError,
        match=r"weights\.npz: (does not match learned\.toml|is not readable); repeat the command that made the folder",
    ):
        load_learned(tmp_path)


LONG = "x" * 9000
CONFIGS = {
    "a long version": {"versions": {"numba": LONG}},
    "versions of other types": {"versions": {"numba": [1], "sigmaswarm": {}}},
    "no versions": {"versions": [LONG]},
    "a long key": {LONG: 1},
    "a key of two lines": {"a\nb": 1},
    "a value of two lines": {"seed": "a\nb"},
    "drives of two lines": {"data": [{"name": "a\nb", "sha256": "\r" * 9}]},
    "a long drive": {"data": [{"name": LONG, "sha256": LONG}] * 99},
    "a long model": {"model": {"name": LONG, "sha256": "\n"}},
}


@pytest.mark.parametrize("how", CONFIGS)
def test_a_damaged_config_of_a_tuning_is_one_line(how: str, tmp_path: Path):
    config = {"seed": 1, "versions": {"numba": "1"}, "data": [], "model": "planar5"}
    (tmp_path / "config.json").write_text(json.dumps(config | CONFIGS[how]))
    with pytest.raises(InputError, match=r"config\.json: ") as raised:
        ResultFolder(tmp_path, config, resume=True)
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 1000 + len(str(tmp_path))


FILTERS = {
    "a long value": f'kind = "{LONG}"',
    "a long key": f"{LONG} = 1",
    "a key of two lines": '"a\\nb" = 1',
    "many digits": f"alpha = {'9' * 4000}",
}


@pytest.mark.parametrize("how", FILTERS)
def test_a_damaged_filter_is_one_line(how: str, tmp_path: Path):
    FilterParameters(0.5, 2.0, 1.0, (1e-4,) * 5, (1.0, 1.0)).save(tmp_path / "t.toml")
    text = (tmp_path / "t.toml").read_text()
    key = FILTERS[how].split(" ")[0]
    kept = [line for line in text.splitlines() if not line.startswith(f"{key} =")]
    at = kept.index("[filter]") + 1
    (tmp_path / "t.toml").write_text("\n".join([*kept[:at], FILTERS[how], *kept[at:]]))
    with pytest.raises(InputError, match=r"t\.toml: ") as raised:
        FilterParameters.load(tmp_path / "t.toml")
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 1000


@pytest.fixture(scope="module")
def two_trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trials")
    trials = tune(DRIVE, out=folder, **TWO_TRIALS).trials
    (folder / "convergence.csv").write_text(history_of(trials).write_csv())
    return folder


TWO_TRIALS = {"particles": 3, "generations": 2, "trials": 2}


@pytest.mark.parametrize(
    "how", ["another tuning", "fewer trials", "more trials", "other costs", "a cut table"]
)
def test_report_refuses_the_history_of_another_tuning(how: str, two_trials: Path, tmp_path: Path):
    file = shutil.copytree(two_trials, tmp_path / "a") / "convergence.csv"
    read_report(tmp_path / "a")
    lines = file.read_text().splitlines()
    if how == "another tuning":
        lines = history_of(tune(DRIVE, seed=1, **TWO_TRIALS).trials).write_csv().splitlines()
    elif how == "fewer trials":
        lines = [line for line in lines if not line.startswith("1,")]
    elif how == "more trials":
        lines += ["2" + line[1:] for line in lines if line.startswith("1,")]
    elif how == "other costs":
        lines = [*lines[:-1], "1,2,3.0,3.0"]
    else:
        lines = [*lines[:-1], "1,1,7.0,7.0"]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"convergence\.csv: does not belong to the tuning\.toml"):
        read_report(tmp_path / "a")


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize(
    "fails_at", ["comparison.md", "comparison.png", "comparison.csv", "runs.csv", "curves.csv"]
)
def test_a_comparison_over_an_older_one_is_whole(
    fails_at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compared: Comparison
):
    save_comparison(compared, tmp_path)
    before = file_contents(tmp_path)
    other = replace(compared, contenders=compared.contenders[::-1])
    write = atomic_file.__wrapped__

    @contextmanager
    def full(path: Path) -> Iterator[object]:
        if path.name == fails_at:
            raise InputError(f"{path}: can't be written (No space left on device)")
        yield from write(path)

    monkeypatch.setattr("sigmaswarm.files.atomic_file", full)
    monkeypatch.setattr("sigmaswarm.reports.figures.atomic_file", full)
    with pytest.raises(InputError, match=fails_at):
        save_comparison(other, tmp_path)
    assert file_contents(tmp_path) == before


@pytest.fixture(scope="module")
def compared() -> Comparison:
    """Two optimizers on a short drive."""
    return compare(DRIVE, optimizers=("pso", "de"), seeds=2, particles=3, generations=2, model="planar5")


NESTED = {
    "objects": b'{"a":' * 100_000,
    "lists": b"[" * 100_000,
    "both": b'[{"a":' * 50_000,
    "an address": b'{"address":' * 50_000,
    "closed": b"[" * 100_000 + b"]" * 100_000,
}


@pytest.mark.parametrize("how", NESTED)
def test_a_damaged_scheduler_file_is_one_line(how: str, tmp_path: Path):
    (tmp_path / "scheduler").write_bytes(NESTED[how])
    with pytest.raises(InputError, match="is not a scheduler file"):
        _scheduler(str(tmp_path / "scheduler"))


@pytest.mark.parametrize("how", NESTED)
def test_damaged_timings_are_taken_anew(how: str, tmp_path: Path):
    (tmp_path / "timings.json").write_bytes(NESTED[how])
    assert content_if_readable(tmp_path / "timings.json") == {}


DRIVES = {
    "lists": b"a = " + b"[" * 3000,
    "tables": b"a = " + b"{a=" * 3000,
    "both": b"a = " + b"[{a=" * 3000,
    "closed": b"scenario = " + b"[" * 3000 + b"]" * 3000,
    "a long key": b"a" + b".a" * 200_000 + b" = 1",
}


@pytest.mark.parametrize("how", DRIVES)
def test_simulate_into_a_damaged_drive_is_one_line(how: str, tmp_path: Path):
    (tmp_path / "drive.toml").write_bytes(DRIVES[how])
    with limited(2), pytest.raises(InputError, match="is not a drive that simulate wrote"):
        _require_made_with(tmp_path / "drive.toml", {"duration": None})
