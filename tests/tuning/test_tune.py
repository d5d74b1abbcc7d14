"""`tune`: the same bits for the same seed, better than random, and warnings about objectives and bounds."""

import shutil
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.sensors import true_std
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import AlignmentError, InputError, SigmaswarmWarning, TuningStopped
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, baseline_of
from sigmaswarm.simulation import simulate
from sigmaswarm.tuning.batch import run_batch
from sigmaswarm.tuning.bounds import TouchedBound
from sigmaswarm.tuning.inflation import Sensitivity
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.search import Progress
from sigmaswarm.tuning.space import search_space
from sigmaswarm.tuning.tune import tune as tune_by_default
from support import make_drive, quickly

pytestmark = pytest.mark.usefixtures("undiagnosed")

DRIVES = [make_drive(duration=25.0, seed=s, name=f"d{s}", imu_rate=50.0) for s in range(2)]
SMALL = {"particles": 6, "generations": 5}
tune = partial(tune_by_default, model="planar5", objective="truth-rmse")
"""The search with the smallest filter and objective; other tests check the defaults."""


def bits(tuning: Tuning) -> list[bytes]:
    arrays = [a for t in tuning.trials for a in (t.point, t.best, t.median)]
    return [a.tobytes() for a in arrays] + [repr((tuning.parameters, tuning.cost)).encode()]


def test_a_likelihood_that_is_incompatible_with_robust_causes_a_warning():
    blind = [replace(d, truth=None) for d in DRIVES]
    with pytest.warns(SigmaswarmWarning, match="even if the filter uses robust; use innovation-t"):
        tune(blind, use=["robust"], objective="innovation-nll + nis", **SMALL)


def test_the_same_seed_gives_the_same_bits_for_any_number_of_workers():
    # more particles than lanes, so that the work is divided
    options = {"particles": 40, "generations": 4, "objective": "truth-pose", "trials": 2, "seed": 5}
    results = [tune(DRIVES, **options)]
    for workers in (1, 2, 4):
        with ThreadPoolExecutor(workers) as pool:
            results.append(tune(DRIVES, executor=pool, **options))
    assert all(bits(r) == bits(results[0]) for r in results)
    assert bits(tune(DRIVES, **(options | {"seed": 6}))) != bits(results[0])


def test_trials_differ_and_the_best_is_selected():
    tuning = tune(DRIVES, trials=4, seed=2, **SMALL)
    costs = [trial.cost for trial in tuning.trials]
    assert len(set(costs)) == 4
    assert tuning.cost == min(costs)
    assert tuning.best_trial == costs.index(min(costs))
    assert tuning.to_dict()["result"]["trial_costs"] == costs
    # a trial does not depend on the number of trials
    assert tune(DRIVES, trials=1, seed=2, **SMALL).trials[0].best.tolist() == tuning.trials[0].best.tolist()


@pytest.mark.filterwarnings("ignore:gps-rmse compares the filter")
def test_the_cost_is_that_of_the_parameters():
    for objective in ("truth-rmse", "truth-pose", "gps-rmse"):
        tuning = tune(DRIVES, objective=objective, **SMALL)
        assert run_batch(DRIVES, [tuning.parameters], objective=objective).costs[0] == tuning.cost


def test_the_history_contains_best_and_median_costs():
    tuning = tune(DRIVES, particles=6, generations=7)
    (trial,) = tuning.trials
    assert trial.best.shape == trial.median.shape == (7,)
    assert np.all(np.diff(trial.best) <= 0)
    assert np.all(trial.median >= trial.best)
    assert trial.best[-1] == trial.cost == tuning.cost
    assert (trial.evaluations, trial.failures) == (42, 0)


def test_the_first_generation_is_around_the_baseline():
    first = list[Progress]()
    tuning = tune(DRIVES, particles=6, generations=2, progress=first.append)
    space = search_space("planar5", "log10", tuning.parameters.nominal_interval)
    shown_std = float(np.median([true_std(drive) for drive in DRIVES]))
    start = space.point_of(baseline_of(DRIVES[0], "planar5", (), shown_std))
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(0,)))
    rng.uniform(size=(6, 10))
    points = np.clip(rng.normal(start, 0.3 * (space.high - space.low), (6, 10)), space.low, space.high)
    points[0] = start
    costs = run_batch(DRIVES, space.decode(points)).costs
    (trial,) = tuning.trials
    assert trial.best[0] == costs.min() == first[0].best_cost
    assert trial.median[0] == np.median(costs)


@pytest.mark.filterwarnings("ignore:gps-rmse compares the filter")
def test_the_paper_s_first_generation_is_uniform():
    drive, first = DRIVES[0], list[float]()

    def stop(progress: Progress) -> bool:
        first.append(progress.best_cost)
        return False

    with pytest.raises(TuningStopped):
        tune_by_default(drive, paper=True, progress=stop)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(0,)))
    space = search_space("planar5", "linear", drive.nominal_interval)
    points = rng.uniform(space.low, space.high, (30, 10))
    assert first == [run_batch([drive], space.decode(points), objective="gps-rmse").costs.min()]


@pytest.mark.parametrize("scale", quickly([("log10",), ("linear",)], lambda scale: scale == "linear"))
def test_it_is_better_than_random_search_and_the_defaults(scale: str):
    wins = []
    for seed in range(5):
        tuning = tune(DRIVES, scale=scale, particles=15, generations=20, seed=seed)
        space = search_space("planar5", scale, tuning.parameters.nominal_interval)
        points = np.random.default_rng(seed + 100).uniform(space.low, space.high, (300, 10))
        wins.append(tuning.cost < run_batch(DRIVES, space.decode(points)).costs.min())
        assert tuning.cost < run_batch(DRIVES, [DEFAULTS]).costs[0]
    assert sum(wins) >= 4


def test_parameters_stay_within_the_bounds_and_touched_bounds_are_reported():
    tuning = tune(
        DRIVES, optimizer="pso", particles=10, generations=15, seed=1
    )  # its particles stop at bounds
    p = tuning.parameters
    for variance in (*p.process_noise, *p.measurement_noise):
        assert 1e-5 <= variance <= 10
    names = ("q_x", "q_y", "q_vx", "q_vy", "q_theta", "r_x", "r_y")
    variances = (*p.process_noise, *p.measurement_noise)
    at_bound = {name: v in (1e-5, 10.0) for name, v in zip(names, variances, strict=True)}
    at_bound |= {
        "alpha": p.alpha in (1e-3, 1.0),
        "beta": p.beta in (0.0, 3.0),
        "kappa": p.kappa in (0.0, 5.0),
    }
    assert {t.parameter for t in tuning.touched_bounds} == {name for name, at in at_bound.items() if at}
    assert tuning.touched_bounds  # for an exact IMU, the optimal Q is below the bounds


@pytest.mark.filterwarnings("ignore:gps-rmse compares the filter")
def test_gps_rmse_copies_the_fixes_and_is_worse_with_respect_to_truth():
    drives = [simulate("urban", run=run, duration=60.0, gps="white-1m", imu_rate=50.0) for run in range(2)]
    options = {"particles": 20, "generations": 20}
    honest, copying = (tune(drives, objective=o, **options).parameters for o in ("truth-rmse", "gps-rmse"))
    ratio = [np.mean(p.measurement_noise) / np.mean(p.process_noise[:2]) for p in (honest, copying)]
    assert ratio[1] < 1e-2 * ratio[0]
    fixes = run_batch(drives, [honest, copying], objective="gps-rmse").costs
    truth = run_batch(drives, [honest, copying]).costs
    assert fixes[1] < 0.05
    assert fixes[1] < 0.2 * fixes[0]
    assert truth[1] > 1.4 * truth[0]


def test_the_search_uses_the_scale():
    log, linear = (tune(DRIVES, scale=scale, **SMALL) for scale in ("log10", "linear"))
    for tuning, value in ((log, lambda v: 10**v), (linear, lambda v: v)):
        point = tuning.trials[0].point
        assert tuning.parameters.alpha == point[0]
        variances = (*tuning.parameters.process_noise, *tuning.parameters.measurement_noise)
        assert variances == pytest.approx(value(point[3:]), rel=1e-9)


@pytest.mark.parametrize(
    "change",
    [{"inertia": 0.3}, {"cognitive": 0.1}, {"social": 0.1}, {"zero_velocity_at_bounds": True}],
    ids=str,
)
def test_the_swarm_uses_each_constant(change: dict):
    swarm = SMALL | {"optimizer": "pso"}
    plain, changed = tune(DRIVES, **swarm), tune(DRIVES, **swarm, **change)
    assert changed.trials[0].best[0] == plain.trials[0].best[0]
    assert changed.trials[0].median[-1] != plain.trials[0].median[-1]


def test_patience_ends_a_trial_without_progress():
    full = tune(DRIVES[:1], particles=3, generations=40, seed=3).trials[0].best
    patience = 3
    stalled = [g for g in range(patience, 40) if full[g] >= full[g - patience]]
    assert stalled[0] < 35  # otherwise, the test is not sensitive
    cut = tune(DRIVES[:1], particles=3, generations=40, seed=3, patience=patience)
    assert cut.trials[0].best.tolist() == full[: stalled[0] + 1].tolist()
    assert cut.trials[0].evaluations == 3 * (stalled[0] + 1)
    assert tune(DRIVES[:1], particles=3, generations=6, patience=40).trials[0].best.size == 6


def test_progress_is_reported_after_every_generation():
    told: list[Progress] = []
    tuning = tune(DRIVES, trials=2, progress=told.append, **SMALL)
    assert [(p.trial, p.generation) for p in told] == [(t, g) for t in range(2) for g in range(1, 6)]
    assert [p.done for p in told] == list(range(1, 11))
    assert {p.total for p in told} == {10}
    assert [p.best_cost for p in told] == [*tuning.trials[0].best, *tuning.trials[1].best]


def test_the_file_contains_everything_needed_to_repeat_the_tuning(tmp_path: Path):
    tuning = tune(DRIVES, out=tmp_path / "out", seed=4, objective="truth-pose", **SMALL)
    table = tomllib.loads((tmp_path / "out" / "tuning.toml").read_text())
    assert FilterParameters.load(tmp_path / "out") == tuning.parameters
    assert table["result"]["cost"] == tuning.cost
    assert table["result"]["touched_bounds"] == list(map(str, tuning.touched_bounds))
    assert set(table["versions"]) == {"sigmaswarm", "python", "numpy", "numba", "scipy"}
    assert [d["name"] for d in table["data"]] == ["d0", "d1"]
    assert table["data"][0]["imu_samples"] == len(DRIVES[0].imu)
    assert table["data"][0]["fixes"] == len(DRIVES[0].gps)
    assert table["config"]["seed"] == 4
    assert table["units"]["states"] == ["x", "y", "vx", "vy", "theta"]
    assert bits(tune(DRIVES, **table["config"])) == bits(tuning)


def test_the_fingerprint_depends_on_the_data():
    print_of = [
        tune(d, particles=2, generations=1).data[0]["sha256"] for d in (DRIVES[0], DRIVES[0], DRIVES[1])
    ]
    assert print_of[0] == print_of[1] != print_of[2]
    changed = replace(DRIVES[0], truth=replace(DRIVES[0].truth, x=DRIVES[0].truth.x + 1e-9))
    assert tune(changed, particles=2, generations=1).data[0]["sha256"] != print_of[0]


def test_nothing_is_written_without_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    tune(DRIVES, **SMALL)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "name"),
    [
        ({"particles": 1}, "particles"),
        ({"particles": -3}, "particles"),
        ({"generations": 0}, "generations"),
        ({"trials": 0}, "trials"),
        ({"seed": -1}, "seed"),
        ({"patience": 0}, "patience"),
        ({"scale": "cubic"}, "scale"),
        ({"model": "planar9"}, "model"),
        ({"objective": "nll"}, "'nll'"),
        ({"particle": 5}, "particle"),
        ({"inertia": float("nan")}, "inertia"),
        ({"social": float("inf")}, "social"),
    ],
    ids=str,
)
def test_the_error_names_a_wrong_option(option: dict, name: str):
    with pytest.raises(InputError) as caught:
        tune(DRIVES, **option)
    assert name in str(caught.value)
    assert str(next(iter(option.values()))) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_drives_that_can_not_be_used_for_tuning_are_rejected(tmp_path: Path):
    with pytest.raises(InputError, match="no drives"):
        tune([])
    with pytest.raises(
        InputError, match=r"d0: has no truth, which the objective truth-rmse needs; without truth"
    ):
        tune(replace(DRIVES[0], truth=None), objective="truth-rmse", out=tmp_path / "out")
    with pytest.raises(InputError, match=r"d0: .* a time too short to hide fixes"):
        tune(clip(DRIVES[0], 0.0, 12.0), objective="outage-rmse", out=tmp_path / "out")
    gps = DRIVES[0].gps
    silent = replace(DRIVES[0], gps=gps.select(gps.time < initial_state(DRIVES[0]).time + 1.0))
    with pytest.raises(InputError, match=r"d0: .* no fixes in the windows"):
        tune(silent, objective="outage-rmse", out=tmp_path / "out")
    zero = np.zeros(len(DRIVES[0].gps))
    still = replace(DRIVES[0], gps=replace(DRIVES[0].gps, x=zero, y=zero))
    with pytest.raises(AlignmentError, match="d0: the vehicle never travels 20 m"):
        tune(still, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()  # no folder remains that would prevent the next attempt


def test_without_truth_the_objective_is_the_prediction_of_the_fixes():
    blind = [replace(d, truth=None) for d in DRIVES]
    auto = partial(tune, objective="auto", **SMALL)
    assert auto(blind).config.objective == "innovation-t"
    assert auto(DRIVES).config.objective == "truth-pose + 0.2 nees"
    with pytest.warns(SigmaswarmWarning, match="d1 has no truth, so the objective is innovation-t"):
        assert auto([DRIVES[0], blind[1]]).config.objective == "innovation-t"
    # truth has no effect
    seen, unseen = (tune(d, objective="innovation-nll + outage-rmse", **SMALL) for d in (DRIVES, blind))
    assert bits(seen) == bits(unseen)


@pytest.mark.parametrize("whole", [True, False])
def test_a_saved_tuning_is_read_unchanged(tmp_path: Path, whole: bool):
    options = {
        "optimizer": "random",
        "trials": 2,
        "use": ["lateral", "latency"],
        "inflation": 0.1,
        "objective": "innovation-t",
    }
    tuning = tune(DRIVES[:1], validation=DRIVES[1:], out=tmp_path / "t", **SMALL, **options)
    file = tmp_path / "t" / "tuning.toml"
    if not whole:  # only the file, as it could be sent to a colleague
        file = Path(shutil.copy(file, tmp_path / "alone.toml"))
    read = Tuning.load(tmp_path / "t" if whole else file)
    assert read.to_dict() == tuning.to_dict()
    assert (read.parameters, read.config, read.sensitivities) == (
        tuning.parameters,
        tuning.config,
        tuning.sensitivities,
    )
    assert [trial.cost for trial in read.trials] == ([*tuning.trial_costs] if whole else [])
    assert [marks.sha256 for marks in read.seen] == [drive["sha256"] for drive in tuning.data]
    assert len(repr(tuning).splitlines()) <= 15
    assert repr(tuning).startswith("Tuned for innovation-t: cost ")
    read.save(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == file.read_bytes()


def test_a_tuning_of_0_3_0_is_read(tmp_path: Path):
    """In that version, the option was called margin, and the keys were doubts and margin_raised_by."""
    tuning = tune(DRIVES, **SMALL, inflation=0.1, objective="innovation-t")
    tuning.save(tmp_path / "t.toml")
    text = (tmp_path / "t.toml").read_text()
    renamed = {
        "\ninflation =": "\nmargin =",
        "inflation_factor": "margin_raised_by",
        "\nwarnings": "\ndoubts",
    }
    for new, old in renamed.items():
        assert new in text
        text = text.replace(new, old)
    (tmp_path / "t.toml").write_text(text)
    read = Tuning.load(tmp_path / "t.toml")
    assert (read.config, read.warnings, read.inflation_factor) == (
        tuning.config,
        tuning.warnings,
        tuning.inflation_factor,
    )
    with pytest.warns(SigmaswarmWarning, match="margin is deprecated, use inflation"):
        assert bits(tune(DRIVES, **SMALL, margin=0.1, objective="innovation-t")) == bits(tuning)


class Walk:
    """An optimizer of a user: it proposes points around its best point and stores nothing else."""

    def __init__(self, low, high, population, rng):
        self.low, self.high, self.population, self.rng = low, high, population, rng
        self.at, self.cost, self.asked = (low + high) / 2, np.inf, np.empty((0, len(low)))

    def ask(self):
        step = 0.2 * (self.high - self.low) * self.rng.standard_normal((self.population, len(self.low)))
        self.asked = self.at + step
        return self.asked

    def tell(self, costs):
        if costs.min() < self.cost:
            self.at, self.cost = self.asked[costs.argmin()], costs.min()

    def state(self):
        return {"at": self.at, "cost": self.cost}

    def restore(self, state):
        self.at, self.cost = np.array(state["at"]), float(state["cost"])


def test_an_optimizer_of_a_user_is_resumed_bit_for_bit(tmp_path: Path):
    options = {"particles": 4, "generations": 6, "optimizer": Walk, "polish": 8}
    whole = tune(DRIVES, **options)
    assert whole.config.model_dump()["optimizer"].endswith(":Walk")

    def stop(progress: Progress) -> None:
        if progress.generation == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(DRIVES, out=tmp_path / "t", progress=stop, **options)
    assert bits(tune(DRIVES, out=tmp_path / "t", resume=True, **options)) == bits(whole)
    assert Tuning.load(tmp_path / "t").cost == whole.cost
    with pytest.raises(InputError, match="has no method tell"):
        tune(
            DRIVES, optimizer=type("Half", (), {"__init__": lambda *_: None, "ask": lambda _: None}), **SMALL
        )


def test_validation_drives_are_scored_and_do_not_change_the_result():
    training, other = DRIVES[:1], make_drive(duration=25.0, seed=9, gps_std=4.0, name="noisy", imu_rate=50.0)
    plain = tune(training, **SMALL)
    assert plain.validation is None
    assert any("the cost is that of the training drives" in remark for remark in plain.remarks)
    strange, blind = (
        "is valid only for the receiver and the IMU of its training drives",
        {"objective": "innovation-t"},
    )
    assert any(strange in remark for remark in plain.remarks)
    without = replace(plain, config=plain.config.model_copy(update=blind))
    assert not any(strange in remark for remark in without.remarks)
    checked = tune(training, validation=other, **SMALL)
    assert bits(checked) == bits(plain)
    assert checked.validation.cost == run_batch(other, [checked.parameters]).costs[0]
    assert checked.validation.gap == pytest.approx(checked.validation.cost / checked.cost - 1)
    assert checked.validation.gap > 0.2
    assert any("larger than on the training drives" in remark for remark in checked.remarks)
    small = replace(checked, validation=replace(checked.validation, gap=0.1))
    assert not any("larger than" in remark for remark in small.remarks)
    failed = replace(checked, validation=replace(checked.validation, cost=np.inf, gap=np.inf))
    assert any("failed on at least one validation drive" in remark for remark in failed.remarks)
    assert checked.to_dict()["result"]["validation_drives"] == ["noisy"]


@pytest.mark.parametrize(
    "optimizer",
    quickly(
        [(n,) for n in ("ga", "ga-pso", "de", "de-qpso", "cma-es", "nelder-mead", "random", "sobol")],
        lambda optimizer: optimizer in ("ga-pso", "nelder-mead"),
    ),
)
def test_every_optimizer_uses_the_same_budget(optimizer: str, tmp_path: Path):
    asked = {"optimizer": optimizer, "particles": 8, "generations": 6, "polish": 12, "seed": 3}
    tuning = tune(DRIVES[:1], **asked)
    (trial,) = tuning.trials
    assert trial.evaluations <= 48
    assert np.all(np.diff(trial.best) <= 0)
    assert tuning.cost == run_batch(DRIVES[0], [tuning.parameters]).costs[0]
    with ThreadPoolExecutor(3) as pool:
        assert bits(tune(DRIVES[:1], executor=pool, **asked)) == bits(tuning)

    class Stop(Exception):
        pass

    def stop(progress: Progress):
        if progress.generation == 3:
            raise Stop

    with pytest.raises(Stop):
        tune(DRIVES[:1], out=tmp_path, progress=stop, **asked)
    assert bits(tune(DRIVES[:1], out=tmp_path, resume=True, **asked)) == bits(tuning)


def test_a_coefficient_of_the_swarm_is_rejected_for_other_optimizers(tmp_path: Path):
    with pytest.raises(InputError, match="inertia is an option of the optimizer pso, not of de"):
        tune(DRIVES[:1], optimizer="de", inertia=0.5, **SMALL)
    with pytest.raises(InputError, match=r"polish = 30 must be less than particles x generations = 30"):
        tune(DRIVES[:1], polish=30, out=tmp_path / "out", **SMALL)
    assert not (tmp_path / "out").exists()


def test_a_validation_drive_of_another_rate_is_run_with_the_same_noise_per_second():
    other = make_drive(duration=25.0, seed=9, imu_rate=25.0, name="slow")
    tuning = tune(DRIVES[:1], validation=other, **SMALL)
    assert tuning.parameters.nominal_interval == pytest.approx(0.02)
    assert tuning.validation.cost == run_batch(other, [tuning.parameters]).costs[0]


def test_a_training_drive_is_rejected_for_validation():
    with pytest.raises(InputError, match="d0 is also a training drive"):
        tune(DRIVES, validation=DRIVES[:1], **SMALL)
    with pytest.raises(InputError, match="got a str"):
        tune(DRIVES, validation=["drives/x"], **SMALL)


def test_validation_can_be_added_to_a_finished_tuning(tmp_path: Path):
    plain = tune(DRIVES[:1], out=tmp_path, **SMALL)
    checked = tune(DRIVES[:1], validation=DRIVES[1], out=tmp_path, resume=True, **SMALL)
    assert bits(checked) == bits(plain)
    assert "validation_cost" in (tmp_path / "tuning.toml").read_text()


def test_each_undetermined_parameter_is_reported_once():
    tuning = tune(DRIVES, **SMALL)
    free = replace(
        tuning,
        touched_bounds=[TouchedBound("alpha", "lower", 1e-3), TouchedBound("q_x", "lower", 1e-5)],
        sensitivities=(
            Sensitivity("alpha", 0.5, None, None),
            Sensitivity("q_x", 1e-5, None, 1e-3),
            Sensitivity("r_x", 1.0, 0.8, 1.2, -0.16),
        ),
    )
    assert free.unidentified == ["alpha"]
    told = " / ".join(free.remarks)
    assert "the tuned values of alpha are arbitrary," in told
    assert "at its lower bound" not in told  # users can't change the bounds of built-in filters
    assert "a change of r_x alone lowers the cost by 16%" in told


def test_densities_are_those_of_continuous_noise():
    tuning = tune(DRIVES, **SMALL)
    p = tuning.parameters
    told = tuning.to_dict()["densities"]["vx"]
    assert float(told.split()[0]) == pytest.approx((p.process_noise[2] / p.nominal_interval) ** 0.5, rel=1e-3)
    assert told.endswith(" m/s/sqrt(s)")


def test_patience_still_runs_the_polish(tmp_path: Path):
    asked = {"particles": 3, "generations": 40, "patience": 3, "polish": 30, "seed": 1}
    tuning = tune(DRIVES[:1], **asked)
    (trial,) = tuning.trials
    stalled = tune(DRIVES[:1], **(asked | {"polish": 0})).trials[0].evaluations
    assert stalled < 90
    assert stalled < trial.evaluations <= stalled + 30
    tune(DRIVES[:1], out=tmp_path, **asked)

    class Stop(Exception):
        pass

    def stop(progress: Progress):
        if progress.generation == len(trial.best) - 2:
            raise Stop

    with pytest.raises(Stop):
        tune(DRIVES[:1], out=tmp_path / "again", progress=stop, **asked)
    assert bits(tune(DRIVES[:1], out=tmp_path / "again", resume=True, **asked)) == bits(tuning)


def test_the_cost_can_consist_of_the_worst_drives_only():
    drives = [DRIVES[0], make_drive(duration=25.0, seed=9, gps_std=3.0, imu_rate=50.0)]
    tuning = tune(drives, worst=0.5, **SMALL)
    each = [run_batch(d, [tuning.parameters]).costs[0] for d in drives]
    assert tuning.cost == max(each)


def test_truth_outside_the_time_of_the_drive_is_rejected():
    late = replace(DRIVES[0], truth=replace(DRIVES[0].truth, time=DRIVES[0].truth.time + 1e4))
    with pytest.raises(InputError, match=r"d0.*truth"):
        tune(late, **SMALL)


def test_an_error_is_raised_if_all_filters_fail():
    ax = DRIVES[0].imu.ax.copy()
    ax[-5] = np.nan
    with pytest.raises(InputError, match=r"no parameter set gave a finite cost.*NaN"):
        tune(replace(DRIVES[0], imu=replace(DRIVES[0].imu, ax=ax)), **SMALL)
