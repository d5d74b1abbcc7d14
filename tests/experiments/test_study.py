"""A whole study: the same bytes after any number of kills, and equal conditions for every method."""

import csv
import json
import math
import random
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from processes import run
from sigmaswarm.drives import alignment
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study import study as study_run
from sigmaswarm.experiments.study.config import DEFAULT_METHOD, StudyConfig, read_config
from sigmaswarm.experiments.study.design import Design, make_design
from sigmaswarm.experiments.study.study import Study, run_study
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise, fitted_noise
from sigmaswarm.filters.run import estimate_of
from sigmaswarm.reports.study_charts import save_study
from sigmaswarm.scoring.drifts import rms_drift
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_pass, outage_windows, tracking_pass
from sigmaswarm.tuning.search import MIN_RACED_DRIVES, TrialRunner
from sigmaswarm.tuning.space import SearchSpace, search_space
from sigmaswarm.tuning.tune import tune
from support import file_contents, no_pictures

TINY = StudyConfig(
    maneuvers=("turns", "outages"), environments=("clear",), runs=3, trials=2, particles=4, generations=3
)
pytestmark = pytest.mark.usefixtures("quick_study")
DIFFERENT = {"timings.json", "runtime.md", "runtime.tex", "runtime.csv"}


contents = partial(file_contents, omitted=DIFFERENT)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Return an uninterrupted study with one worker."""
    study = run_study(TINY, tmp_path_factory.mktemp("study") / "whole", workers=1)
    with no_pictures():
        save_study(study, study.folder)
    return study


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(TINY)


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("kills", [2, pytest.param(6, marks=pytest.mark.long)])
def test_a_study_killed_several_times_ends_in_the_same_bytes(whole: Study, tmp_path: Path, kills: int):
    """Kill the process (SIGKILL) at random times of its tuning, and resume it."""
    out = tmp_path / "killed"
    (tmp_path / "study.toml").write_text(TINY.to_toml())
    program = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from sigmaswarm.experiments.study.config import read_config\n"
        "from sigmaswarm.experiments.study.study import run_study\n"
        "left = int(sys.argv[1])\n"
        "def tell(_):\n"
        "    global left\n"
        "    left -= 1\n"
        "    if left == 0:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        f"run_study(read_config(Path({str(tmp_path / 'study.toml')!r})), {str(out)!r}, resume=True, workers=2,\n"
        "          progress=tell)\n"
    )
    draw = random.Random(5)
    for _ in range(kills):
        ended = run(program, draw.randint(1, 5))
        assert ended.returncode == -signal.SIGKILL
    study = run_study(TINY, out, resume=True)
    save_study(study, study.folder)
    assert contents(out) == contents(whole.folder)


@pytest.mark.long
def test_finished_trials_are_not_repeated(whole: Study, monkeypatch: pytest.MonkeyPatch):
    before = contents(whole.folder)
    # the checkpoint remains if a run is killed after saving the trial, and before deleting the checkpoint
    (whole.folder / "trials/paper-pso-ukf/checkpoint-000.npz").write_bytes(b"")
    monkeypatch.setattr(TrialRunner, "_generation", lambda *_: pytest.fail("a finished trial was redone"))
    run_study(TINY, whole.folder, resume=True)
    assert contents(whole.folder) == before


def test_the_number_of_parallel_tunings_is_the_number_of_cores(whole: Study, monkeypatch: pytest.MonkeyPatch):
    """The default number of threads in Python is larger; one worker starts no process."""
    seen: list[int] = []

    def grid(*_: object, processes: int, **__: object) -> object:
        seen.append(processes)
        raise InterruptedError

    def threads(workers: int) -> ThreadPoolExecutor:
        seen.append(workers)
        return ThreadPoolExecutor(workers)

    monkeypatch.setattr(study_run, "cores", lambda: 3)
    monkeypatch.setattr(study_run, "run_grid", grid)
    monkeypatch.setattr(study_run, "ThreadPoolExecutor", threads)
    for workers in (None, 1):
        with pytest.raises(InterruptedError):
            run_study(TINY, whole.folder, resume=True, workers=workers)
    with ThreadPoolExecutor(2) as own, pytest.raises(InterruptedError):
        run_study(TINY, whole.folder, resume=True, executor=own)
    assert seen == [3, 3, 1, 0, 0]


def test_a_trial_agrees_with_tune_from_a_uniform_generation(
    whole: Study, design: Design, monkeypatch: pytest.MonkeyPatch
):
    """The shared, prepared drives give the same bits as a separate tuning with the same split."""
    monkeypatch.setattr("sigmaswarm.tuning.tune._center", lambda problem: None)
    train = [design.drives[i] for i in design.split(0)[0]]
    asked = {
        "pso-planar8": design.tune_config("pso-planar8", "honest").model_dump() | {"trials": 1},
        DEFAULT_METHOD: {"particles": 4, "generations": 3, "as_recorded": True, "inflation": 0.0},
    }
    for method, options in asked.items():
        tuning = tune(train, **options)
        task = next(t for t in whole.trials if (t.method, t.trial) == (method, 0))
        assert whole.trials[task].cost == tuning.cost
        assert whole.parameters[task] == tuning.parameters


def test_all_trials_race_or_none(design: Design):
    racing = make_design(TINY.model_copy(update={"racing": True}))
    assert all(racing.tune_config(method, protocol).racing for protocol, method in TINY.tuned)
    assert not any(design.tune_config(method, protocol).racing for protocol, method in TINY.tuned)


def test_racing_is_the_default_for_many_training_drives():
    def races(of_each: int, **asked: object) -> bool:
        strata = tuple(name for name in ("turns-clear", "turns-rain") for _ in range(of_each))
        config = TINY.model_copy(update=asked)
        return Design((), (("", ""),) * len(strata), strata, config).tune_config("pso-ukf", "honest").racing

    enough = math.ceil(MIN_RACED_DRIVES / 2 / TINY.train_fraction)
    assert races(enough)
    assert not races(enough - 2)
    assert not races(enough, per_condition=True)
    assert races(2 * enough, per_condition=True)
    assert not races(enough, racing=False)
    assert races(3, racing=True)


def test_a_given_value_of_racing_is_saved(tmp_path: Path):
    for racing, kept in ((None, False), (True, True), (False, True)):
        config = TINY.model_copy(update={"racing": racing})
        (tmp_path / "study.toml").write_text(config.to_toml())
        assert ("racing" in config.to_toml()) == kept
        assert read_config(tmp_path / "study.toml") == config


def test_the_budget_counts_the_first_generation(whole: Study):
    assert {trial.evaluations for trial in whole.trials.values()} == {4 * 3}
    assert StudyConfig().particles * StudyConfig().generations == 1500


def test_every_trial_splits_every_condition_differently(design: Design):
    splits = [design.split(trial) for trial in range(8)]
    assert len({tuple(train) for train, _ in splits}) > 3
    for train, test in splits:
        assert sorted(train + test) == list(range(6))
        assert [design.conditions[i][0] for i in test] == ["turns", "outages"]


def test_scores_are_of_held_out_drives_only(whole: Study):
    with (whole.folder / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    for trial in range(TINY.trials):
        held_out = {whole.design.drives[i].name for i in whole.design.split(trial)[1]}
        assert {row["drive"] for row in rows if row["trial"] == str(trial)} == held_out
    found = {(row["protocol"], row["method"]) for row in rows}
    assert {"untuned", "paper", "honest"} == {protocol for protocol, _ in found}
    assert len(found) == 16


def test_results_agree_with_the_scores(whole: Study):
    results = json.loads((whole.folder / "results.json").read_text())
    with (whole.folder / "scores.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["measure"] == "heading_rmse_deg"]
    for summary in results["summary"]:
        if summary["measure"] != "heading_rmse_deg" or summary["maneuver"] != "all":
            continue
        own = [r for r in rows if (r["protocol"], r["method"]) == (summary["protocol"], summary["method"])]
        each = [np.mean([float(r["value"]) for r in own if r["trial"] == str(t)]) for t in range(2)]
        assert summary["mean"] == pytest.approx(np.mean(each))
        assert summary["sd"] == pytest.approx(np.std(each, ddof=1))


def test_raw_gps_has_no_error_by_the_paper_s_measure(whole: Study):
    raw = whole.results.summary("untuned", "raw-gps", "gps_rmse_m")
    assert raw is not None
    assert raw.mean == 0.0


def test_the_fixes_alone_are_a_row_without_tuning(whole: Study):
    design = whole.design
    noise = MotionNoise.typical(map(fitted_noise, design.prepared))
    found: dict[str, list[float]] = {"position_rmse_m": [], "outage_drift_m": []}
    for ready in design.prepared:
        placed = {"length": OUTAGE_LENGTH, "seed": design.config.seed}
        ends = outage_windows(ready.drive, ready.initial, **placed)[:, 1]
        estimate, hidden = (
            estimate_of(FixesAlone(replay, noise), recover=False)
            for replay in (tracking_pass(ready), outage_pass(ready, **placed))
        )
        found["position_rmse_m"].append(score_estimate(ready.drive, estimate).position_rmse)
        found["outage_drift_m"].append(rms_drift(ready, hidden, ends))
    for measure, each in found.items():
        of_trials = [np.mean([each[i] for i in design.split(trial)[1]]) for trial in range(2)]
        row = whole.results.summary("untuned", "fixes-alone", measure)
        assert row is not None
        assert row.mean == pytest.approx(np.mean(of_trials))
    assert whole.results.summary("untuned", "fixes-alone", "nis") is None


@pytest.mark.long
def test_each_condition_can_be_tuned_separately(tmp_path: Path):
    config = TINY.model_copy(update={"per_condition": True, "generations": 1})
    study = run_study(config, tmp_path / "out")
    assert len(study.trials) == 2 * 6 * 2
    assert (tmp_path / "out" / "best" / "honest-pso-ukf-turns-clear.toml").exists()
    summary = study.results.summary("honest", "pso-ukf", "position_rmse_m")
    assert summary is not None
    assert summary.n_drives >= 2


def test_drives_of_the_user(tmp_path: Path, design: Design):
    for drive in design.drives[:3]:
        write_drive(drive, tmp_path / "drives" / drive.name)
    config = TINY.model_copy(update={"drives": (str(tmp_path / "drives"),), "generations": 1})
    assert [drive.name for drive in make_design(config).drives] == [d.name for d in design.drives[:3]]


def test_a_different_study_is_not_resumed(whole: Study, tmp_path: Path):
    with pytest.raises(InputError, match="add --resume"):
        run_study(TINY, whole.folder)
    other = TINY.model_copy(update={"seed": 1})
    with pytest.raises(InputError, match="seed = 0, but this command has 1"):
        run_study(other, whole.folder, resume=True)


def test_the_configuration_is_saved_with_the_study(whole: Study):
    assert read_config(whole.folder / "study.toml") == TINY


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trials = 1", "trials = 1"),
        ("particels = 30", "no such option"),
        ("trials = [", "not readable"),
    ],
)
def test_errors_in_the_file_are_reported(tmp_path: Path, text: str, message: str):
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_config(path)


def test_drives_without_truth_are_refused(tmp_path: Path, design: Design):
    for drive in design.drives[:2]:
        write_drive(drive, tmp_path / "drives" / drive.name)
        (tmp_path / "drives" / drive.name / "truth.csv").unlink()
    with pytest.raises(InputError, match="has no truth"):
        make_design(TINY.model_copy(update={"drives": (str(tmp_path / "drives"),)}))


@pytest.mark.long
@pytest.mark.usefixtures("unpainted")
def test_each_drive_is_aligned_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Search, scores, tracks, pictures and timings share the alignment; no search space is computed twice."""
    aligned: list[str] = []
    spaces: list[tuple[object, ...]] = []

    def counted(drive: Drive, **options: bool) -> InitialState:
        aligned.append(drive.name)
        return initial_state(drive, **options)

    def made(*asked: object, **more: object) -> SearchSpace:
        spaces.append((*asked, *more.values()))
        return search_space(*asked, **more)

    monkeypatch.setattr("sigmaswarm.drives.prepared.initial_state", counted)
    monkeypatch.setattr("sigmaswarm.tuning.problem.search_space", made)
    for module in [m for name, m in sys.modules.items() if name.startswith("sigmaswarm.")]:
        if getattr(module, "initial_state", None) is initial_state and module is not alignment:
            monkeypatch.setattr(module, "initial_state", counted)
    study = run_study(TINY.model_copy(update={"generations": 1}), tmp_path / "out")
    save_study(study, study.folder)
    assert sorted(aligned) == sorted(drive.name for drive in study.design.drives)
    assert len(spaces) == len(set(spaces)) == 6
