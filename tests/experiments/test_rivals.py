"""Other methods in a study: the same drives and scores as for filters, and the same bytes after any number of kills."""

import csv
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from quick_learners import Quick, QuickNoises, QuickOutages
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.statistics import Draws
from sigmaswarm.experiments.study import study
from sigmaswarm.experiments.study.config import METHODS, StudyConfig, read_config
from sigmaswarm.experiments.study.design import Task, designs_elsewhere, make_design
from sigmaswarm.experiments.study.networks import MIN_DRIVING_TIME, Training, training_drives, trainings
from sigmaswarm.experiments.study.results import _gains
from sigmaswarm.experiments.study.scores import ScoreTable
from sigmaswarm.experiments.study.study import Study, StudyProgress, run_study
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.learned.folder import load_learned
from sigmaswarm.learned.learn import LEARNERS
from sigmaswarm.reports import study_charts as reports
from sigmaswarm.reports.read import read_report
from sigmaswarm.reports.study_charts import save_study, study_figures
from sigmaswarm.reports.study_tables import study_tables
from sigmaswarm.scoring.targets import outage_windows, tracking_pass
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.search import TrialRunner
from sigmaswarm.tuning.tune import tune
from support import file_contents, quickly, require

require("optax", "JAX and Optax are not installed (extra learned)")
require("sklearn", "scikit-learn is not installed (extra bo)")

TINY = StudyConfig(
    maneuvers=("outages",),
    environments=("clear",),
    runs=7,
    trials=2,
    particles=4,
    generations=2,
    rivals=True,
    learn_minutes=2.4,
)
TIMED = {
    "timings.json",
    *(f"{name}.{end}" for name in ("runtime", "runtime-rivals") for end in ("md", "tex", "csv")),
}
NETWORKS = ("outage-lstm", "noise-gru")
REAL = {name: LEARNERS[name] for name in NETWORKS}


@pytest.fixture(scope="module", autouse=True)
def quick(quick_study: None) -> Iterator[None]:
    """Replace the networks by ones that train within a second; `tests/learned` checks the real ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(LEARNERS, "outage-lstm", QuickOutages)
        patch.setitem(LEARNERS, "noise-gru", QuickNoises)
        yield


@pytest.fixture(scope="module", params=[pytest.param(None, marks=pytest.mark.long, id="trained")])
def whole(tmp_path_factory: pytest.TempPathFactory) -> Study:
    found = run_study(TINY, tmp_path_factory.mktemp("rivals") / "whole")
    # Draw only the figure of the other methods; test_study draws the others.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            reports, "study_figures", lambda of: {"learning-curve": study_figures(of)["learning-curve"]}
        )
        save_study(found, found.folder)
    return found


contents = partial(file_contents, omitted=TIMED)


def scores(folder: Path, trial: int, method: str) -> dict[tuple[str, str], float]:
    """Return the scores of a method by drive and measure."""
    with (folder / "scores.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if (row["trial"], row["method"]) == (str(trial), method)]
    return {
        (row["drive"], row["measure"]): float(row["value"]) for row in rows if row["protocol"] == "honest"
    }


def rms(drive: Drive, time: np.ndarray, mean: np.ndarray, at: np.ndarray) -> float:
    """Return the RMS position error at some times (k,), m."""
    t = drive.truth
    off = [np.interp(at, time, mean[:, i]) - np.interp(at, t.time, (t.x, t.y)[i]) for i in range(2)]
    return float(np.sqrt(np.mean(np.square(off).sum(axis=0))))


def blinded(drive: Drive, length: float) -> tuple[PreparedDrive, np.ndarray]:
    """Return a drive without the fixes in outages, and the ends of the outages."""
    ready = PreparedDrive(drive, as_recorded=True)
    windows = outage_windows(drive, ready.initial, length=length, seed=0)
    hidden = replace(drive, gps=drive.gps.select(~hidden_fixes(drive.gps.time, windows)))
    return PreparedDrive(hidden, ready.initial, as_recorded=True), windows[:, 1]


# ---- scores ----


@pytest.mark.parametrize("network", quickly([(n,) for n in NETWORKS], lambda network: network == "noise-gru"))
def test_the_scores_of_a_network_agree_with_a_separate_run(whole: Study, network: str):
    """Load the network from its folder and run it on the drives that the trial held out."""
    trial = 1
    learned = load_learned(whole.folder / f"learned/{network}/trial-001")
    parameters = FilterParameters.load(whole.folder / f"learned/{network}/trial-001" / "tuning.toml")
    assert learned is not None
    assert parameters == whole.parameters[Task("honest", "pso-planar8", "all", trial)]
    told, alone = scores(whole.folder, trial, network), scores(whole.folder, trial, "pso-planar8")
    tested = [whole.design.drives[i] for i in whole.design.split(trial)[1]]
    assert {drive for drive, _ in told} == {drive.name for drive in tested}
    for drive in tested:
        ready = PreparedDrive(drive, as_recorded=True)
        truth = drive.truth.select(drive.truth.time >= ready.initial.time)
        run = learned.run(tracking_pass(ready), parameters)
        found = run.whole()
        position = rms(drive, found.time, found.mean, truth.time)
        assert told[drive.name, "position_rmse_m"] == pytest.approx(position, rel=0.01)
        turned = wrap_angle(np.interp(truth.time, found.time, np.unwrap(found.mean[:, 4])) - truth.theta)
        turned = turned[np.hypot(truth.vx, truth.vy) > 2.0]
        assert told[drive.name, "heading_rmse_deg"] == pytest.approx(
            np.degrees(np.sqrt(np.mean(turned**2))), rel=0.01
        )
        assert told[drive.name, "nis"] == pytest.approx(float(np.mean(run.innovations.nis)))
        for measure, length in (("outage_drift_m", 5.0), ("outage_drift_15_s_m", 15.0)):
            blind, ends = blinded(drive, length)
            there = learned.run(tracking_pass(blind), parameters).whole()
            assert told[drive.name, measure] == pytest.approx(rms(drive, there.time, there.mean, ends))
    key = "outage_drift_15_s_m" if network == "outage-lstm" else "nis"
    assert all(told[drive.name, key] != alone[drive.name, key] for drive in tested)


def test_the_tuned_methods_agree_with_tune(whole: Study):
    train = [whole.design.drives[i] for i in whole.design.split(0)[0]]
    usual = {
        "particles": 4,
        "generations": 2,
        "as_recorded": True,
        "model": "planar5",
        "objective": "truth-rmse",
    }
    for method, options in {
        "pso-fuzzy-ukf": {"kind": "fuzzy-ukf", "optimizer": "pso"},
        "bo-ukf": {"optimizer": "bo"},
    }.items():
        found = tune(train, **usual, **options, trials=1)
        assert whole.parameters[Task("honest", method, "all", 0)] == found.parameters


def test_bayesian_optimization_has_a_hundred_evaluations(whole: Study):
    for particles, generations, most in ((30, 50, 90), (250, 2, 100), (4, 2, 8)):
        config = TINY.model_copy(update={"particles": particles, "generations": generations, "racing": True})
        asked = replace(whole.design, config=config).tune_config("bo-ukf", "honest")
        assert (asked.particles * asked.generations, asked.racing) == (most, False)


def test_the_drift_of_a_filter_uses_the_same_longer_outages(whole: Study):
    own = scores(whole.folder, 0, "pso-planar8")
    p = whole.parameters[Task("honest", "pso-planar8", "all", 0)]
    for i in whole.design.split(0)[1]:
        drive = whole.design.drives[i]
        blind, ends = blinded(drive, 15.0)
        found = run_filter(blind, p, recover=False)
        assert own[drive.name, "outage_drift_15_s_m"] == pytest.approx(
            rms(drive, found.time, found.mean, ends)
        )
        assert (drive.name, "outage_drift_60_s_m") not in own  # no outage of 60 s fits


# ---- training data ----


def test_training_data_are_parts_of_the_trial_s_training_drives(whole: Study):
    for trial in range(2):
        ours = {whole.design.drives[i].name for i in whole.design.split(trial)[0]}
        few, more = (training_drives(whole.design, trial, minutes) for minutes in (1.2, 2.4))
        for of, seconds in ((few, 72.0), (more, 144.0)):
            assert {d.name for d in (*of.training, *of.held_back)} <= ours
            assert of.driven == pytest.approx(seconds, abs=MIN_DRIVING_TIME + 1.0)
            assert len(of.held_back) == len((*of.training, *of.held_back)) // 3
            assert sum(
                d.imu.time[-1] - PreparedDrive(d).initial.time for d in (*of.training, *of.held_back)
            ) == pytest.approx(of.driven, abs=0.1)
        assert {d.name for d in (*few.training, *few.held_back)} <= {
            d.name for d in (*more.training, *more.held_back)
        }
    names = [[d.name for d in training_drives(whole.design, trial, 2.0).training] for trial in range(2)]
    assert names[0] != names[1]
    everything = training_drives(whole.design, 0, 1000.0)
    assert len(everything.training) + len(everything.held_back) == len(whole.design.split(0)[0])


def test_the_folder_of_a_network_lists_its_training_data(whole: Study):
    for network in NETWORKS:
        for trial in range(2):
            learned = load_learned(whole.folder / f"learned/{network}/trial-{trial:03d}")
            assert learned is not None
            of = training_drives(whole.design, trial, 2.4)
            assert [entry.name for entry in learned.record.data] == [drive.name for drive in of.training]
            assert learned.record.training.held_back == ", ".join(drive.name for drive in of.held_back)
            assert learned.record.training.seed == trial


def test_too_short_drives_are_rejected_before_any_tuning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(TrialRunner, "trial", lambda *_: pytest.fail("tuned already"))
    with pytest.raises(InputError, match=r"too little data to train networks.*add drives"):
        run_study(TINY.model_copy(update={"maneuvers": ("brake",)}), tmp_path / "out")


# ---- tables ----


def test_the_tables_contain_the_other_methods(whole: Study):
    tables = {name: table.to_markdown() for name, table in study_tables(whole.results).items()}
    for name in ("table-2", "table-3", "rivals", "elsewhere-1", "elsewhere-2"):
        for label in (method.label for method in METHODS.values() if method.rival):
            assert f"| {label} (tuned with truth) |" in tables[name], (name, label)
    against = {c.against for c in whole.results.comparisons if c.protocol == "honest"}
    assert {*NETWORKS, "bo-ukf", "pso-fuzzy-ukf"} <= against
    row = next(
        line for line in tables["rivals"].splitlines() if line.startswith("| planar8 with outage-lstm")
    )
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    found = whole.results.summary("honest", "outage-lstm", "outage_drift_15_s_m")
    low, high = found.bootstrap_interval
    assert cells[5] == f"{found.mean:.2f} [{low:.2f}, {high:.2f}]"
    assert cells[7] == "-"  # no outage of 60 s fits
    training = [whole.design.drives[i] for i in whole.design.split(0)[0]]
    assert float(cells[1]) == pytest.approx(sum(d.duration for d in training), abs=1.0)
    driven = np.mean([training_drives(whole.design, trial, 2.4).driven for trial in range(2)])
    weights = load_learned(whole.folder / "learned/outage-lstm/trial-000").record.network.numbers
    tuned = len(whole.trials[Task("honest", "pso-planar8", "all", 0)].point)
    assert (cells[2], cells[3]) == (f"{driven:.0f}", f"{tuned + weights}")


def test_networks_are_compared_with_the_filter_that_they_assist(whole: Study):
    gains = {(c.method, c.measure): c for c in whole.results.rivals.gains}
    assert {c.against for c in gains.values()} == {"pso-planar8"}
    assert {method for method, _ in gains} == set(NETWORKS)
    for measure in ("outage_drift_m", "outage_drift_15_s_m", "heading_rmse_deg"):
        of_drives: dict[str, list[float]] = {}
        for trial in range(2):
            told, alone = (scores(whole.folder, trial, m) for m in ("noise-gru", "pso-planar8"))
            for drive, what in told:
                if what == measure:
                    of_drives.setdefault(drive, []).append(told[drive, what] - alone[drive, what])
        found = gains["noise-gru", measure]
        assert found.n_drives == len(of_drives)
        assert found.mean_difference == pytest.approx(np.mean([np.mean(d) for d in of_drives.values()]))
    table = study_tables(whole.results)["rivals-gains"].to_markdown()
    assert "favor the network" in table


def test_a_measure_that_a_network_does_not_change_is_omitted(whole: Study):
    position, drift = np.random.default_rng(0).uniform(1.0, 2.0, (2, 2, len(whole.design.drives)))
    values = {
        ("honest", "pso-planar8"): {"position_rmse_m": position, "outage_drift_m": drift},
        ("honest", "outage-lstm"): {"position_rmse_m": position * (1 + 1e-15), "outage_drift_m": 0.9 * drift},
    }
    taught = dict.fromkeys(Task("honest", "outage-lstm", "all", trial) for trial in range(2))
    (gain,) = _gains(ScoreTable(whole.design, values), taught, Draws(0))
    assert (gain.measure, gain.improvement) == ("outage_drift_m", pytest.approx(10.0))


def test_other_simulated_drives_have_the_vibration_and_terrain_of_the_configuration():
    few = {"maneuvers": ("turns",), "environments": ("clear",), "runs": 2, "rivals": True}
    home = make_design(StudyConfig(**few, vibration=1.0, terrain="rolling"))
    elsewhere = [drive for other in designs_elsewhere(home).values() for drive in other.drives]
    for drive in (*home.drives, *elsewhere):
        scenario = drive.metadata["scenario"]
        assert (scenario["vibration"], scenario["terrain"]) == (1.0, "rolling")


def test_times_are_in_separate_files(whole: Study):
    assert "per sample, us" not in (whole.folder / "tables/rivals.md").read_text()
    text = (whole.folder / "tables/runtime-rivals.md").read_text()
    assert "training, s" in text
    times = json.loads((whole.folder / "timings.json").read_text())["rivals"]
    assert set(times) == {f"{effort.protocol}-{effort.method}" for effort in whole.results.rivals.efforts}
    for variant in ("honest-pso-planar8", "honest-outage-lstm", "honest-bo-ukf"):
        assert times[variant]["training_s"] > 0.0
        assert times[variant]["sample_us"] > 0.0
    kept = [
        json.loads((whole.folder / f"trials/honest-bo-ukf/trial-{k:03d}/timings.json").read_text())[
            "processor_s"
        ]
        for k in range(2)
    ]
    assert times["honest-bo-ukf"]["training_s"] == pytest.approx(np.mean(kept))


def test_the_other_drives_have_another_imu_or_another_car(whole: Study):
    (imu, car) = designs_elsewhere(whole.design).values()
    assert {d.metadata["imu_noise"]["grade"] for d in imu.drives} == {"mpu-6050"}
    assert {d.metadata["vehicle"] for d in car.drives} == {"model3-carla"}
    assert {d.metadata["imu_noise"]["grade"] for d in car.drives} == {"icm-20602"}
    assert not {d.gps.x.tobytes() for d in whole.design.drives} & {d.gps.x.tobytes() for d in imu.drives}
    drive = imu.drives[0]
    p = whole.parameters[Task("honest", "pso-planar8", "all", 1)]
    estimate = run_filter(PreparedDrive(drive, as_recorded=True), p, recover=False)
    own = scores(whole.folder / "elsewhere/IMU-mpu-6050-for-icm-20602", 1, "pso-planar8")
    truth = drive.truth.select(drive.truth.time >= estimate.initial.time)
    off = rms(drive, estimate.time, estimate.mean, truth.time)
    assert own[drive.name, "position_rmse_m"] == pytest.approx(off, rel=0.01)
    assert {name for name, _ in own} == {d.name for d in imu.drives}


def test_the_learning_curve_ends_with_the_study_s_network(whole: Study):
    curve = [p for p in whole.results.rivals.curve if (p.method, p.measure) == ("noise-gru", "nis")]
    assert [p.minutes for p in curve] == pytest.approx([0.0, 2.0, 2.4], abs=0.35)
    for point, method in ((curve[0], "pso-planar8"), (curve[-1], "noise-gru")):
        own = [v for (_, measure), v in scores(whole.folder, 0, method).items() if measure == "nis"]
        assert point.mean == pytest.approx(np.mean(own))
        assert point.n_drives == len(own)
    assert (whole.folder / "figures/learning-curve.png").stat().st_size > 0


def test_the_page_contains_the_other_methods(whole: Study):
    section = next(s for s in read_report(whole.folder).sections if s.title == "Rivals")
    captions = [table.caption.split(":")[0] for table in section.tables]
    alone = "Networks compared with PSO-UKF, planar8 (tuned with truth) without a network"
    assert captions == ["Rivals", alone, "Other drives", "Other drives", "Learning curves"]
    assert "per sample, us" in [column.title for column in section.tables[0].columns]
    assert len(section.charts) == 3  # there is no result for 30 s


# ---- interruptions and errors ----


class Stopped(Exception):
    pass


@pytest.mark.long
def test_an_interrupted_study_ends_in_the_same_bytes(whole: Study, tmp_path: Path):
    """Interrupt the training in a trial, then in a learning curve; finished epochs are not repeated."""
    out = tmp_path / "parts"
    made = ("tables", "figures", "elsewhere", "results.json", "scores.csv")
    shutil.copytree(whole.folder, out, ignore=shutil.ignore_patterns("learned", *made))
    tuned, total = len(list(whole.design.tasks)) * TINY.generations, 6 * len(trainings(whole.design))
    told: list[StudyProgress] = []
    for at in (3, 4 * 6 + 2):

        def stop(progress: StudyProgress, at: int = at) -> None:
            told.append(progress)
            if progress.done == tuned + at:
                raise Stopped

        with pytest.raises(Stopped):
            run_study(TINY, out, resume=True, progress=stop)
        assert len(list((out / "learned").glob("*/*/checkpoint-000.npz"))) == 1
    run_study(TINY, out, resume=True, progress=told.append)
    done = [progress.done - tuned for progress in told if progress.task.method in NETWORKS]
    assert all(done.count(epoch) == 1 for epoch in (1, 2, 3, 4, 5, 25, 26, 27))
    assert (told[-1].done, told[-1].total) == (tuned + total, tuned + total)
    kept = {path: data for path, data in contents(whole.folder).items() if path.split("/")[0] not in made[:2]}
    assert contents(out) == kept


def test_a_trained_network_is_not_trained_again(whole: Study, monkeypatch: pytest.MonkeyPatch):
    def scores(*_: object) -> None:
        raise Stopped

    monkeypatch.setattr(Quick, "__init__", lambda *_: pytest.fail("trained again"))
    monkeypatch.setattr(TrialRunner, "_generation", lambda *_: pytest.fail("tuned again"))
    monkeypatch.setattr(study, "score_all", scores)
    before = contents(whole.folder)
    with pytest.raises(Stopped):
        run_study(TINY, whole.folder, resume=True)
    assert contents(whole.folder) == before


def test_the_configuration_is_saved_with_the_study(whole: Study):
    assert read_config(whole.folder / "study.toml") == TINY
    plain = StudyConfig()
    assert not re.search("rivals|learn_minutes|elsewhere", plain.to_toml())
    assert whole.results.content()["config"]["learn_minutes"] == 2.4


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*gaps; the longest")
def test_drives_of_the_user_for_training_and_for_the_other_test(whole: Study, tmp_path: Path):
    for drive in whole.design.drives[:5]:
        write_drive(drive, tmp_path / "mine" / drive.name)
    other = replace(simulate("outages", seed=9, imu="adis16488"), name="other")
    write_drive(other, tmp_path / "others" / "other")
    config = TINY.model_copy(
        update={
            "drives": (str(tmp_path / "mine"),),
            "elsewhere": (str(tmp_path / "others"),),
            "generations": 1,
        }
    )
    found = run_study(config, tmp_path / "out")
    own = [row for row in found.results.rivals.elsewhere if row.method == "noise-gru"]
    assert {row.place for row in own} == {"as given"}
    assert {row.n_drives for row in own} == {1}
    alone = make_design(config.model_copy(update={"elsewhere": ()}))
    assert designs_elsewhere(alone) == {}
    twice = make_design(config.model_copy(update={"elsewhere": (str(tmp_path / "mine"),)}))
    with pytest.raises(InputError, match="s of this drive are also in outages-clear-00"):
        designs_elsewhere(twice)


@pytest.mark.long
def test_a_study_with_the_real_networks(whole: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The test takes about two minutes."""
    for name, learner in REAL.items():
        monkeypatch.setitem(LEARNERS, name, learner)
    found = run_study(TINY.model_copy(update={"learn_minutes": 2.0}), tmp_path / "out")
    for network in NETWORKS:
        learned = load_learned(tmp_path / "out" / Training(network, 0).folder)
        assert learned.record.training.epochs > 5
    assert found.results.summary("honest", "noise-gru", "position_rmse_m").mean < 10.0
