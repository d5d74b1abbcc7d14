"""`compare`: each run is a tuning, resumed runs have the same bytes, and the statistics follow their definitions."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.compare import compare
from sigmaswarm.experiments.comparison import MIN_SEEDS, Comparison
from sigmaswarm.experiments.statistics import holm, signed_rank
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise, fitted_noise
from sigmaswarm.filters.run import estimate_of
from sigmaswarm.reports.compare import comparison_table, save_comparison
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.tuning.batch import run_batch
from sigmaswarm.tuning.tune import tune
from support import file_contents, make_drive, no_pictures

DRIVES = [make_drive(duration=15.0, seed=s, name=f"d{s}") for s in range(2)]
HELD_OUT = [make_drive(duration=15.0, seed=7, name="other")]
RIVALS = ("pso", "random", "pso:particles=4,generations=3,trials=2", "de:racing=true")
ASKED = {"model": "planar5", "objective": "truth-rmse"}
OPTIONS = {
    **ASKED,
    "optimizers": RIVALS,
    "seeds": 3,
    "validation": HELD_OUT,
    "particles": 8,
    "generations": 3,
}


pytestmark = pytest.mark.usefixtures("unpainted", "undiagnosed")


contents = partial(file_contents, omitted={"times.csv"})


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Comparison, Path]:
    folder = tmp_path_factory.mktemp("whole")
    comparison = compare(DRIVES, out=folder, workers=1, scales=("log10", "linear"), **OPTIONS)
    with no_pictures():
        save_comparison(comparison, folder)
    return comparison, folder


def test_each_run_is_a_tuning_from_a_uniform_generation(whole, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sigmaswarm.tuning.tune._center", lambda problem: None)
    comparison, _ = whole
    tuning = tune(DRIVES, optimizer="pso", particles=8, generations=3, seed=2, scale="linear", **ASKED)
    run = comparison.runs["pso, linear"][2]
    assert run.cost == tuning.cost
    assert run.held_out_cost == run_batch(HELD_OUT, [tuning.parameters]).costs[0]
    assert run.history_best == tuple(tuning.trials[0].best)
    assert run.history_evaluations == (8, 16, 24)
    steps = comparison.steps_per_set
    assert run.history_steps == (8 * steps, 16 * steps, 24 * steps)
    trials = tune(DRIVES, optimizer="pso", particles=4, generations=3, trials=2, seed=1, **ASKED)
    run = comparison.runs[f"{RIVALS[2]}, log10"][1]
    assert run.cost == run.history_best[-1] == trials.cost
    assert run.history_evaluations == (4, 8, 12, 16, 20, 24)
    raced = tune(DRIVES, optimizer="de", particles=8, generations=3, seed=0, racing=True, **ASKED)
    assert comparison.runs["de:racing=true, log10"][0].history_steps[-1] == raced.steps < raced.full_steps


@pytest.mark.long
def test_the_number_of_threads_changes_no_byte(whole, tmp_path: Path):
    comparison = compare(DRIVES, out=tmp_path, workers=4, scales=("log10", "linear"), **OPTIONS)
    save_comparison(comparison, tmp_path)
    assert contents(tmp_path) == contents(whole[1])
    assert {p.name for p in tmp_path.iterdir()} == {
        *("config.json", "runs", "times.csv", "comparison.md", "comparison.png"),
        *("comparison.csv", "runs.csv", "curves.csv"),
    }
    lines = (tmp_path / "times.csv").read_text().splitlines()
    assert lines[0] == "optimizer,scale,seed,cpu_seconds"
    assert len(lines) == 1 + 2 * 4 * 3


@pytest.mark.long
def test_a_comparison_interrupted_after_a_run_ends_in_the_same_bytes(whole, tmp_path: Path):

    def stop(done: int, total: int):
        assert total == 24
        if done == 9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(DRIVES, out=tmp_path, progress=stop, scales=("log10", "linear"), **OPTIONS)
    comparison = compare(DRIVES, out=tmp_path, resume=True, scales=("log10", "linear"), **OPTIONS)
    save_comparison(comparison, tmp_path)
    assert contents(tmp_path) == contents(whole[1])


def test_if_every_run_was_interrupted_the_times_are_empty(whole, tmp_path: Path):
    shutil.copytree(whole[1], tmp_path / "killed")
    for file in (tmp_path / "killed").rglob("run.json"):
        file.unlink()
    (tmp_path / "killed" / "times.csv").unlink()
    compare(DRIVES, out=tmp_path / "killed", resume=True, scales=("log10", "linear"), **OPTIONS)
    assert (tmp_path / "killed" / "times.csv").read_text() == "optimizer,scale,seed,cpu_seconds\n"


def test_the_tables_contain_the_costs_of_the_runs(whole):
    comparison, folder = whole
    row = comparison.frame.row(1, named=True)
    assert (row["optimizer"], row["scale"], row["seeds"]) == ("random", "log10", 3)
    costs = [run.cost for run in comparison.runs["random, log10"]]
    assert row["cost_median"] == np.median(costs)
    assert (row["cost_low"], row["cost_high"], row["cost_worst"]) == (min(costs), max(costs), max(costs))
    assert comparison.frame["cost_p"][0] is None
    raw = [
        signed_rank(comparison.values(c.label, "cost"), comparison.values("pso, log10", "cost"))
        for c in comparison.contenders[1:]
    ]
    assert comparison.frame["cost_p"].to_list()[1:] == holm(raw)
    said = (folder / "comparison.md").read_text()
    assert "3 seeds, 24 evaluations per run" in said
    assert said.endswith("\n\nThere are too few seeds for the tests, which need 6 or more.\n")
    header, _, _, random, *_ = (line.split(" | ") for line in said.splitlines())
    low, middle, high = sorted(costs)
    assert random[2:5] == [f"{middle:.4g} [{low:.4g}, {high:.4g}]", f"{high:.4g}", "-"]
    assert header[2:5] == ["training cost [95%]", "worst", "p"]
    assert len((folder / "runs.csv").read_text().splitlines()) == 1 + 24


def test_the_fixes_alone_are_fitted_to_the_training_drives(whole):
    comparison, folder = whole
    noise = MotionNoise.typical(fitted_noise(PreparedDrive(drive)) for drive in DRIVES)
    alone = FixesAlone(tracking_pass(PreparedDrive(HELD_OUT[0])), noise)
    score = score_estimate(HELD_OUT[0], estimate_of(alone, recover=False))
    assert comparison.fixes_alone_rmse == score.position_rmse
    assert f"held-out RMSE of {comparison.fixes_alone_rmse:.4g} m" in (folder / "comparison.md").read_text()


def test_with_enough_seeds_the_table_contains_tests(whole):
    few = whole[0]
    enough = replace(few, runs={label: runs * 2 for label, runs in few.runs.items()})
    assert enough.seeds == 6 == MIN_SEEDS
    table = comparison_table(enough)
    assert "too few" not in table.to_markdown()
    assert [row[5] for row in table.rows] == enough.frame["cost_p"].to_list()
    assert signed_rank(np.arange(1.0, MIN_SEEDS + 1), np.zeros(MIN_SEEDS)) < 0.05
    assert signed_rank(np.arange(1.0, MIN_SEEDS), np.zeros(MIN_SEEDS - 1)) > 0.05


def test_the_curves_agree_with_a_plain_count(whole):
    comparison, _ = whole
    label, at = "pso, log10", 50  # after half of 24 evaluations, one generation of 8 is finished
    rows = comparison.curves.filter(comparison.curves["optimizer"] == "pso")
    row = rows.row(at - 1, named=True)
    assert row["full_evaluations"] == 12
    assert row["median"] == np.median([run.history_best[0] for run in comparison.runs[label]])
    last = rows.row(99, named=True)
    assert last["median"] == np.median([run.cost for run in comparison.runs[label]])
    assert rows.row(0, named=True)["median"] == np.inf


def test_each_drive_is_aligned_once(monkeypatch: pytest.MonkeyPatch):
    aligned: list[str] = []

    def counted(drive: Drive, **options: bool) -> InitialState:
        aligned.append(drive.name)
        return initial_state(drive, **options)

    monkeypatch.setattr("sigmaswarm.drives.prepared.initial_state", counted)
    compare(DRIVES, validation=HELD_OUT, optimizers=("pso", "random"), seeds=2, particles=4, generations=1)
    assert sorted(aligned) == ["d0", "d1", "other"]


# --- Errors --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"optimizers": ["pso", "ants"]}, "no optimizer is called 'ants'; choose from pso"),
        ({"optimizers": []}, "at least one optimizer"),
        ({"optimizers": ["pso", "pso"]}, "named twice"),
        ({"optimizers": ["pso", "pso:particles=9"]}, "27 evaluations"),
        ({"optimizers": ["pso:wings=2"]}, "'wings=2' is not a setting"),
        ({"optimizers": ["pso:polish"]}, "'polish' is not a setting"),
        ({"optimizers": ["pso:polish=many"]}, "polish = 'many'"),
        ({"optimizers": ["pso:polish=24"]}, "polish = 24 must be less"),
        ({"optimizers": ["de:inertia=0.5"]}, "inertia is an option of the optimizer pso"),
        ({"scales": ["cubic"]}, "cubic"),
        ({"seeds": 0}, "seeds = 0"),
        ({"seed": 3}, "use seeds instead"),
        ({"objective": "rmse"}, "'rmse'"),
    ],
    ids=str,
)
def test_a_wrong_option_is_named_before_any_work(change: dict, said: str, tmp_path: Path):
    with pytest.raises(InputError) as caught:
        compare(DRIVES, out=tmp_path / "out", **(OPTIONS | change))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_different_or_corrupted_comparison_is_not_resumed(whole, tmp_path: Path):
    shutil.copytree(whole[1], tmp_path / "out")
    asked = {**OPTIONS, "scales": ("log10", "linear"), "out": tmp_path / "out"}
    with pytest.raises(InputError, match="add --resume"):
        compare(DRIVES, **asked)
    with pytest.raises(InputError, match="seeds = 3, but this command has seeds = 4"):
        compare(DRIVES, resume=True, **(asked | {"seeds": 4}))
    (tmp_path / "out/runs/random-log10-001/run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json: not readable \(.*\); delete it"):
        compare(DRIVES, resume=True, **asked)


def test_by_default_it_compares_with_the_default_filter_of_the_drives():
    found = compare(DRIVES, optimizers=("random",), seeds=1, particles=4, generations=1)
    config = found.contenders[0].config
    assert (config.model, config.use) == ("planar8", ("lateral", "standstill", "robust"))
    assert config.objective == "truth-pose + 0.2 nees"
