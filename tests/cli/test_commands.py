"""Each command does what its help states, with output for people and for programs."""

import json
import re
import shlex
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import polars as pl
import pytest
import tomli_w

import sigmaswarm as library
from sigmaswarm.cli.app import app
from sigmaswarm.cli.evaluate import WORSE_STEP
from sigmaswarm.cli.remarks import name_files, name_training_files
from sigmaswarm.cli.tune import MAX_DIAGNOSED, _larger_drifts, _with_velocity
from sigmaswarm.datasets.dataset import LocalDataset
from sigmaswarm.doctor.findings import Diagnosis, Finding
from sigmaswarm.doctor.split import split_time
from sigmaswarm.drives.drive import Imu
from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.experiments.study import config as study_config
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.config import Option, TuneConfig
from sigmaswarm.tuning.diagnostics import DriftComparison, drift_table
from sigmaswarm.tuning.objectives import OBJECTIVES
from sigmaswarm.tuning.receiver import StdCheck
from sigmaswarm.tuning.record import ResultRecord, TuningRecord
from support import make_drive, no_pictures, several

PNG = b"\x89PNG\r\n\x1a\n"
COMMANDS = ["tune", "evaluate", "report", "run", "split", "simulate", "plot", "demo"]
QUICK = ["--particles", 4, "--generations", 2]
METHODS = ["tuned", "untuned", "fixes_alone", "raw_gps", "imu_only"]


def is_picture(path: Path) -> bool:
    return path.read_bytes().startswith(PNG) and path.stat().st_size > 5000


def test_help_names_every_command(sigmaswarm):
    ended = sigmaswarm("--help")
    assert ended.code == 0
    assert [c for c in COMMANDS if c not in ended.out] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_s_help_has_an_example_and_json(sigmaswarm, command: str):
    ended = sigmaswarm(command, "--help")
    assert ended.code == 0
    assert f"sigmaswarm {command} " in ended.out
    assert "--json" in ended.out


def test_help_is_short():
    for name in (name for name in app if not name.startswith("-")):
        summary, *_ = app[name].help.strip().split("\n\n")
        assert len(summary) <= 76, summary
        for argument in app[name].assemble_argument_collection(parse_docstring=True):
            text = argument.parameter.help or ""
            assert len(text.split()) <= 20, f"{name} {argument.name}: {text}"


@pytest.mark.parametrize("command", ["tune", "import"])
def test_help_shows_twelve_options_and_help_all_the_rest(sigmaswarm, command: str):
    options = re.compile(r"^│ .{3}(--[a-z-]+)|^│ (--[a-z-]+)", re.MULTILINE)
    short, whole = (sigmaswarm(command, flag).out for flag in ("--help", "--help-all"))
    shown, every = ({"".join(found) for found in options.findall(text)} for text in (short, whole))
    known = {a.name for a in app[command].assemble_argument_collection() if a.name.startswith("--")}
    assert len(shown) <= 13
    assert shown < every == known
    assert f"sigmaswarm {command} --help-all shows all options." in short


@pytest.mark.parametrize(
    "command", ["tune", "import", "compare", "simulate", "evaluate", "doctor", "export", "split"]
)
def test_options_are_explained_in_twenty_words(command: str):
    for argument in app[command].assemble_argument_collection(parse_docstring=True):
        assert 0 < len((argument.parameter.help or "").split()) <= 20, argument.name
    summary = app[command].help.splitlines()[0]
    assert re.fullmatch(r"[A-Z][^:;]*\.", summary), summary


def test_the_help_of_tune_explains_each_objective_and_each_value_of_use(sigmaswarm):
    said = sigmaswarm("tune", "--help").out
    for name in (*OBJECTIVES, *get_args(Option)):
        assert re.search(rf"^ ({name}|nis, {name}|{name}, nees) +\S+ \S+", said, re.MULTILINE), name


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_the_help_states_what_happens_to_earlier_results(command: str):
    arguments = {
        a.name: a.parameter.help or ""
        for a in app[command].assemble_argument_collection(parse_docstring=True)
    }
    if "--out" in arguments and command not in ("demo", "workbench"):
        rules = ("is replaced", "must not contain")
        assert "--overwrite" in arguments or any(rule in arguments["--out"] for rule in rules)


@pytest.mark.parametrize(
    ("particles", "inflation", "remedy"),
    [
        (4, 5.0, "tune with the default --particles and --generations"),
        (30, 5.0, "tune on more or longer drives"),
        (30, 1.0, "tune on more or longer drives"),
    ],
)
def test_a_drift_larger_than_the_baseline_s_names_a_safe_step(particles: int, inflation: float, remedy: str):
    forecasts = [DriftComparison(5.0, 1.0, 2.0, 9.0), DriftComparison(30.0, 7.13, 6.36, 59.4)]
    config = TuneConfig(particles=particles, objective="innovation-t")
    record = TuningRecord(
        filter={},
        result=ResultRecord(
            cost=1.0, objective="innovation-t", inflation_factor=inflation, trial_costs=(1.0,)
        ),
        config=config.model_dump(),
        forecasts=forecasts,
        data=[DriveRecord(name="a", duration_s=60.0)],
    )
    (said,) = _larger_drifts(record)
    assert "drifts MORE than the baseline" in said.what and said.remedy.endswith(remedy)
    assert ("a drive with at least 40 s after the filter's start; " in said.remedy) is (particles == 30)
    for length, short in ((39.2, " (a-test has only 39 s); "), (40.0, "start; ")):
        (said,) = _larger_drifts(record, ("a-test", length))
        assert (f"40 s after the filter's start{short.removeprefix('start')}" in said.remedy) is (
            particles == 30
        )
    record.forecasts = forecasts[:1]
    assert not [*_larger_drifts(record)]


def test_an_outage_length_that_is_always_measured_has_one_column(
    sigmaswarm, tuned: Path, drives: Path, here: Path
):
    drive = drives / "urban-clear-00"
    ended = sigmaswarm("evaluate", tuned, drive, "--outage-length", 1, "--verbose", "--out", "e", "--json")
    assert ended.code == 0
    table = sigmaswarm("evaluate", tuned, drive, "--outage-length", 1, "--verbose")
    assert table.code == 0
    heading = table.out[: table.out.index("tuned UKF")]
    assert heading.count("outage") == 1, heading
    assert table.out.count("1 s outage drift of the tuned filter") == 1


def test_a_missing_outage_drift_is_explained(sigmaswarm, tuned: Path, drives: Path, here: Path):
    drive = read_drive(drives / "urban-clear-00")
    write_drive(clip(drive, end=drive.imu.time[0] + 30), here / "short")
    for more in ((), ("--verbose",)):
        short = sigmaswarm("evaluate", tuned, "short", *more).out
        assert (
            short.count("\nNo 30 s outage drift: urban-clear-00 can't contain") == 1 and "No 5 s" not in short
        )
    both = sigmaswarm("evaluate", tuned, "short", drives / "urban-clear-00").out
    assert "No 30 s outage drift" in both


def test_a_remark_on_drive_toml_names_the_file(sigmaswarm, drives: Path, here: Path):
    drive = read_drive(drives / "urban-clear-00")
    smooth = {name: np.interp(drive.gps.time, drive.truth.time, getattr(drive.truth, name)) for name in "xy"}
    gps = replace(drive.gps, std_x=None, std_y=None, **smooth)
    write_drive(replace(drive, name="car", truth=None, gps=gps, metadata={}), here / "logs/car")
    options = (*QUICK, "--model", "planar8", "--verbose")
    said = sigmaswarm("tune", "logs/car", "--out", "t", *options).out
    assert "write it as gps_std_m at the top of logs/car/drive.toml" in " ".join(said.split())
    about = Path("logs/car/drive.toml")
    about.write_text("gps_std_m = 1.5\n" + about.read_text())
    assert "gps_std_m" not in sigmaswarm("tune", "logs/car", "--out", "u", *options).out


def disturbed(start: float, end: float) -> library.Drive:
    """Return a 160 s drive with 0.1 m of noise in the fixes, and 0.6 m between two times, s."""
    drive = simulate("urban", duration=160.0, imu_rate=50.0, gps="white-1m")
    rng, time, truth = np.random.default_rng(4), drive.gps.time, drive.truth
    noise = np.where((time > start) & (time < end), 0.6, 0.1) * rng.standard_normal((2, len(time)))
    x, y = np.array([np.interp(time, truth.time, v) for v in (truth.x, truth.y)]) + noise
    return replace(drive, name="car", gps=type(drive.gps)(time, x, y), truth=None, metadata={})


@pytest.mark.parametrize(("start", "end"), several([(12.0, 32.0), (0.0, 20.0), (100.0, 125.0)], each=3))
def test_the_split_that_leaves_out_disturbed_fixes_leads_to_a_tuning_and_an_evaluation(
    sigmaswarm, here: Path, start: float, end: float
):
    write_drive(disturbed(start, end), "logs/car")
    said = sigmaswarm("doctor", "logs/car").out
    found = re.search(
        r"cut this part out of the drive: sigmaswarm (split logs/car --at [-\d. ]+ --out parts)\n", said
    )
    assert found, said
    steps = [found[1]]
    while not steps[0].startswith("tune"):
        ended = sigmaswarm(*shlex.split(steps[0]))
        assert ended.code == 0, ended.err
        new = re.findall(r"^(?:next|then): sigmaswarm (.*?)(?:    .*)?$", ended.out, re.M)
        steps = new if steps[0].startswith("split") else steps[1:]
    tune, evaluate = map(shlex.split, steps)
    assert sigmaswarm(*tune, *QUICK).code == sigmaswarm(*evaluate).code == 0
    trained, tested = (read_drive(folder).imu.time for folder in (tune[1], evaluate[2]))
    assert trained[-1] < tested[0] or tested[-1] < trained[0]
    for time in (trained, tested):
        assert time[-1] <= start + 8.0 or time[0] >= end - 8.0  # windows are 10 s long


@pytest.mark.parametrize(("at", "next_part"), [((10.0, 30.0), "after"), ((120.0, 155.0), "before")])
def test_a_part_that_is_too_short_for_an_evaluation_is_not_proposed_for_it(
    sigmaswarm, here: Path, at: tuple[float, float], next_part: str
):
    write_drive(disturbed(0.0, 0.0), "logs/car")
    said = sigmaswarm("split", "logs/car", "--at", *at, "--out", "parts")
    assert "can't be used as a drive" not in said.err
    assert f"next: sigmaswarm split parts/car-{next_part} --out parts-2" in said.out


NAMES = " (tune --help explains the names)"
REMEDY = StdCheck(0.24, 5.0, 1.0, 2.0).message


def test_a_line_for_a_part_is_proposed_for_the_whole_drive(here: Path):
    whole = replace(simulate("urban", duration=30.0, imu_rate=50.0), name="car")
    write_drive(whole, "logs/car")
    for part in split_time(read_drive("logs/car"), 0.5):
        write_drive(part, f"parts/{part.name}")
    here_it_is = "at the top of logs/car/drive.toml (the whole drive)"
    again = "; then run sigmaswarm split logs/car --out parts --overwrite and tune again with a new folder"
    named = name_files(REMEDY, [Path("parts/car-train")])
    assert here_it_is in named and named.endswith(again)
    assert name_training_files([REMEDY], ["car-train"], ["parts/car-test"]) == [named]
    (named,) = name_training_files([REMEDY], ["bus"], ["parts/car-test"])
    assert "at the top of drive.toml of bus; then " in named
    Path("parts").rename("mended-parts")  # parts of a repaired copy name this copy
    write_drive(read_drive("logs/car"), "mended/car")
    Path("logs/car/imu.csv").unlink()
    named = name_files(REMEDY, [Path("mended-parts/car-train")])
    assert "run sigmaswarm split mended/car --out mended-parts " in named
    Path("parts/car-train").mkdir(parents=True)
    Path("parts/car-train/drive.toml").write_text('repaired = ["x"]\n[cut_from]\ndrive = "lost"\n')
    named = name_files(REMEDY, [Path("parts/car-train")])
    assert "at the top of drive.toml of the whole drive lost; then " in named
    assert named.endswith("; then split and repair this drive again and tune again with a new folder")


def test_version(sigmaswarm):
    assert sigmaswarm("--version").out.strip() == library.__version__


def test_tune_writes_filter_history_and_pictures(sigmaswarm, drives: Path, here: Path):
    ended = sigmaswarm("tune", drives, "--out", "t", "--particles", 4, "--generations", 3, "--trials", 2)
    assert ended.code == 0
    table = tomllib.loads(Path("t/tuning.toml").read_text())
    assert "\ncost" not in ended.out
    because = "since the IMU has six axes"
    assert f"model: tilted12 with lateral, standstill, robust, {because}{NAMES}\n" in ended.out
    assert (table["config"]["model"], table["config"]["use"]) == (
        "tilted12",
        ["lateral", "standstill", "robust"],
    )
    assert table["config"]["particles"] == 4
    assert [d["name"] for d in table["data"]] == ["urban-clear-00", "urban-clear-01"]
    drifts = drift_table([DriftComparison(**each) for each in table["forecasts"]])
    for row in drifts.to_text().splitlines()[1:]:
        assert re.search(r"\n" + re.sub(" +", " +", row), ended.out)
    history = pl.read_csv("t/convergence.csv")
    assert history.columns == ["trial", "generation", "best_cost", "median_cost"]
    assert history["generation"].to_list() == [1, 2, 3] * 2
    assert history["best_cost"].min() <= table["result"]["cost"]  # of the filter with inflated process noise
    assert Path("t/convergence.png").exists()
    assert Path("t/training-track.png").exists()
    for touched in table["result"]["touched_bounds"]:
        assert touched in ended.out
    # tune again, starting from the written parameters
    again = sigmaswarm(
        *("tune", drives, "--out", "t", "--particles", 4, "--generations", 3, "--trials", 2, "--resume"),
        "--verbose",
    )
    assert again.code == 0
    cost = f"cost {table['result']['cost']:.4f} (truth-pose + 0.2 nees; "
    assert re.search(rf"\n{re.escape(cost)}.* on 2 drives\n", again.out)
    assert tomllib.loads(Path("t/tuning.toml").read_text()) == table


def test_tune_prints_the_same_as_the_library(sigmaswarm, drives: Path, here: Path):
    options = (
        "--particles 5 --generations 3 --seed 9 --objective truth-pose --scale linear --workers 1 --json"
    )
    more = "--optimizer pso --inertia 0.6 --zero-velocity-at-bounds --patience 2"
    given = (drives / "urban-clear-01", drives / "urban-clear-00", *options.split(), *more.split())
    ended = sigmaswarm("tune", *given, "--out", "t")
    said = json.loads(ended.out)
    expected = library.tune(
        [read_drive(drives / name) for name in ("urban-clear-01", "urban-clear-00")],
        optimizer="pso",
        particles=5,
        generations=3,
        seed=9,
        objective="truth-pose",
        scale="linear",
        inertia=0.6,
        zero_velocity_at_bounds=True,
        patience=2,
    )
    assert said == json.loads(json.dumps(expected.to_dict()))
    assert said["filter"] == tomllib.loads(Path("t/tuning.toml").read_text())["filter"]


def test_gps_rmse_warns(sigmaswarm, drives: Path, here: Path):
    ended = sigmaswarm(
        "tune",
        drives,
        "--out",
        "t",
        "--particles",
        2,
        "--generations",
        1,
        "--objective",
        "gps-rmse",
        "--json",
    )
    assert ended.code == 0
    assert "warning: gps-rmse compares the filter with the fix of the last update" in ended.err
    json.loads(ended.out)
    assert "Warning" not in ended.err  # one sentence without a source line


def test_evaluate_prints_the_same_as_the_library(sigmaswarm, drives: Path, tuned: Path, here: Path):
    ended = sigmaswarm("evaluate", tuned, drives, "--json")
    said = json.loads(ended.out)
    read = [read_drive(drives / f"urban-clear-0{i}") for i in range(2)]
    assert said == library.evaluate(read, FilterParameters.load(tuned)).to_dict()
    assert list(said["drives"]) == ["urban-clear-00", "urban-clear-01"]
    assert list(said["mean"]) == METHODS
    assert list(here.iterdir()) == []


@pytest.mark.usefixtures("painted")
def test_evaluate_prints_a_table_and_writes_files(sigmaswarm, drives: Path, tuned: Path, here: Path, caplog):
    ended = sigmaswarm("evaluate", tuned, drives, "--out", "e", "--outage-length", 4)
    assert ended.code == 0
    assert sum(max(1, -(-len(line) // 80)) for line in ended.out.splitlines()) <= 27
    assert "urban-clear-01" not in ended.out
    said = json.loads(Path("e/scores.json").read_text())
    for method in METHODS:
        value = said["mean"][method]["position_rmse_m"]
        assert f"{value:.4g}" in ended.out
    best = min(said["mean"][m]["position_rmse_m"] for m in METHODS[1:])
    assert best == said["mean"]["untuned"]["position_rmse_m"]
    improvement = said["improvement_percent"]["untuned"]["position_rmse_m"]
    assert improvement < 0, "the filter of the fixture is not tuned"
    assert f"{-improvement:.0f}% HIGHER than the baseline ({best:.3g} m)" in ended.out
    assert "lower than" not in ended.out
    assert re.search(r" 4 s *\n", ended.out)  # header of the drift column
    assert " 30 s " not in ended.out.replace(
        "No 30 s outage drift: 2 drives can't contain such an outage, which needs 40 s after the start of the filter.",
        "",
    )
    consistent = json.loads(Path("e/scores.json").read_text())["consistency"]
    careful = sum(c["mean_nis"] < c["nis_band_95"][0] for c in consistent.values())
    assert careful
    assert ended.out.endswith(f"next: sigmaswarm report e\n{WORSE_STEP}\n"), (
        "a worse filter must not be exported"
    )
    frame = pl.read_csv("e/scores.csv")
    assert frame.filter(drive="urban-clear-01", method="tuned")["position_rmse_m"][0] == pytest.approx(
        said["drives"]["urban-clear-01"]["tuned"]["position_rmse_m"]
    )
    names = {p.name for p in Path("e").glob("*.png")}
    assert names == {"comparison.png"} | {
        f"urban-clear-0{i}-{kind}.png" for i in range(2) for kind in ("track", "error", "consistency")
    }
    assert all(is_picture(p) for p in Path("e").glob("*.png"))
    with no_pictures():
        whole = sigmaswarm("evaluate", tuned, drives, "--out", "e2", "--outage-length", 4, "--verbose").out
    assert all(name in whole for name in [*names, "urban-clear-01 ", "whiteness"])
    assert (
        f"On {careful} of 2 drives the filter is underconfident: the standard deviations of its predictions are "
        in whole
    )
    assert [record.getMessage() for record in caplog.records] == []  # no warning from matplotlib


def test_report_writes_a_page_of_an_evaluation(sigmaswarm, drives: Path, tuned: Path, here: Path):
    assert sigmaswarm("evaluate", tuned, drives, "--out", "e", "--outage-length", 4).code == 0
    ended = sigmaswarm("report", "e")
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == "wrote e/page.html\n"
    text = Path("e/page.html").read_text()
    assert text.startswith("<!doctype html>")
    assert "Outages last 1, 4 and 30 s" in text
    assert json.loads(sigmaswarm("report", "e", "--out", "other.html", "--json").out) == {"out": "other.html"}
    assert Path("other.html").read_text() == text


def test_evaluate_a_drive_without_truth(sigmaswarm, drives: Path, tuned: Path, here: Path):
    library.write_drive(library.simulate(duration=40.0, run=3, imu_rate=50.0), "blind")
    Path("blind/truth.csv").unlink()
    ended = sigmaswarm("evaluate", tuned, "blind", "--out", "e", "--json")
    assert ended.code == 0, ended.err
    said = json.loads(ended.out)["mean"]
    assert said["tuned"]["position_rmse_m"] is None
    assert said["tuned"]["outage_drift_m"] > 0
    assert not list(Path("e").glob("*-error.png"))
    assert Path("e/comparison.png").exists()
    alone = sigmaswarm("evaluate", tuned, "blind").out
    assert "drift" in alone
    assert "position RMSE" not in alone.replace("\n", " ")  # no columns without values
    (far,) = re.findall(r"Position error on urban-clear-03: .*", alone)
    scores = json.loads(Path("e/scores.json").read_text())["consistency"]["urban-clear-03"]
    assert far.count(". ") == 1, "two sentences"
    verbose = sigmaswarm("evaluate", tuned, "blind", "--verbose").out
    assert re.search(rf"Position error on urban-clear-03: .*{scores['own_sigma_m']:.2g} m RMS", verbose)
    assert "raw GPS" not in alone
    shown = sigmaswarm("evaluate", tuned, "blind", drives / "urban-clear-00", "--verbose").out
    assert "RMSE" in shown
    assert "raw GPS" in shown
    assert "\nurban-clear-03: there is no truth, so errors of position and heading are unknown. " in shown
    assert shown.count("Position error on") == 1, "where there is truth, it tells"
    assert shown.endswith("next: to save scores, figures and the data for a report, add --out evaluation\n")


def test_run_writes_csv(sigmaswarm, drives: Path, tuned: Path, here: Path):
    ended = sigmaswarm("run", tuned, drives / "urban-clear-00", "--out", "estimate.csv", "--json")
    frame = pl.read_csv("estimate.csv")
    states = ["x", "y", "vx", "vy", "theta"]
    assert frame.columns == ["t", *states, *(f"std_{s}" for s in states)]
    estimate = run_filter(read_drive(drives / "urban-clear-00"), FilterParameters.load(tuned))
    np.testing.assert_array_equal(frame["t"], estimate.time)
    np.testing.assert_array_equal(frame.select(states).to_numpy(), estimate.mean)
    variances = np.stack([estimate.covariance[:, i, i] for i in range(5)], axis=1)
    np.testing.assert_allclose(
        frame.select([f"std_{s}" for s in states]).to_numpy() ** 2, variances, rtol=1e-12
    )
    assert json.loads(ended.out) == {
        "out": "estimate.csv",
        "estimates": len(frame),
        "start_s": frame["t"][0],
        "end_s": frame["t"][-1],
        "restarts_s": [],
    }


def test_run_reports_resets(sigmaswarm, tuned: Path, here: Path):
    drive = library.simulate("urban", run=1, gps="white-1m", duration=65, imu_rate=50.0)
    off = (drive.gps.time > 30) & (drive.gps.time < 55)
    gps = replace(drive.gps, x=drive.gps.x + 300.0 * off)
    library.write_drive(replace(drive, gps=gps), "aside")
    sure = (1e-6, 1e-6, 1e-4, 1e-4, 1e-8)
    parameters = replace(FilterParameters.load(tuned), process_noise=sure, gate=9.2)
    parameters.save("gated.toml")
    restarts = list(run_filter(read_drive("aside"), parameters).restarts)
    assert restarts
    ended = sigmaswarm("run", "gated.toml", "aside", "--out", "e.csv", "--json")
    assert json.loads(ended.out)["restarts_s"] == restarts
    said = sigmaswarm("run", "gated.toml", "aside", "--out", "e.csv", "--overwrite").out
    assert f"the filter diverged and was reset at t = {restarts[0]:.2f}" in said


def test_run_writes_tum(sigmaswarm, drives: Path, tuned: Path, here: Path):
    ended = sigmaswarm("run", tuned, drives / "urban-clear-00", "--out", "estimate.tum")
    assert np.loadtxt("estimate.tum").shape[1] == 8
    assert f"wrote estimate.tum: {len(np.loadtxt('estimate.tum'))} estimates, t = " in ended.out
    assert list(here.iterdir()) == [here / "estimate.tum"]


def at_rest_before(imu: Imu, seconds: float) -> Imu:
    """Insert samples of standstill before the first sample."""
    time = np.arange(imu.time[0] - seconds, imu.time[0] - 0.005, 0.01)
    columns = {name: v for name, v in vars(imu).items() if v is not None and name != "time"}
    rows = {name: np.append(np.full(len(time), 9.81 * (name == "az")), v) for name, v in columns.items()}
    return Imu(time=np.append(time, imu.time), **rows)


@pytest.mark.long
def test_a_second_tuning_of_the_same_drives_proposes_a_comparison(sigmaswarm, drives: Path, here: Path):
    quick = ("--particles", 4, "--generations", 2, "--trust-log")
    first = sigmaswarm("tune", drives, "--out", "first", *quick, "--model", "planar5")
    assert "--against" not in first.out
    sigmaswarm(
        "evaluate", "first", drives, "--out", "an-evaluation"
    )  # it contains a copy of the first tuning
    noise = tomllib.loads(Path("first/tuning.toml").read_text())["fixes_alone"]
    assert json.loads(Path("an-evaluation/evaluation.json").read_text())["fixes_alone"] == noise
    other = sigmaswarm("tune", drives / "urban-clear-00", "--out", "other", *quick)
    assert "--against" not in other.out, "it was tuned with other drives"
    (said,) = re.findall(
        "sigmaswarm (evaluate .*)", sigmaswarm("tune", drives, "--out", "second", *quick).out
    )
    assert said == "evaluate second HELD_OUT_DRIVE... --out evaluation --against first"
    words = said.replace("HELD_OUT_DRIVE...", str(drives / "urban-clear-00")).split()
    table = sigmaswarm(*words, "--verbose").out
    assert "other UKF" in table and "tuned EKF, tilted12" in table and "baseline" in table
    assert "To compare with another tuning" not in table
    assert "To compare with another tuning" in sigmaswarm("evaluate", "second", drives, "--verbose").out


def test_the_tuning_to_compare_with_is_found_from_the_current_folder(
    sigmaswarm, drives: Path, here: Path, monkeypatch: pytest.MonkeyPatch
):
    """Also if OUT is the current folder, or a link to a different folder."""
    quick = ("--particles", 4, "--generations", 2, "--trust-log", "--model", "planar5")
    assert sigmaswarm("tune", drives, "--out", "first", *quick).code == 0
    for folder in ("second", "deep"):
        (here / folder).mkdir()
    monkeypatch.chdir(here / "second")
    assert "--against ../first\n" in sigmaswarm("tune", drives, "--out", ".", *quick).out
    monkeypatch.chdir(here)
    (here / "third").mkdir()
    (here / "deep" / "link").symlink_to(here / "third")
    assert "--against second\n" in sigmaswarm("tune", drives, "--out", "deep/link", *quick).out


def test_lines_that_need_action_come_first_and_begin_alike(sigmaswarm, drives: Path, here: Path):
    quick = ("--particles", 4, "--generations", 2, "--trust-log")
    options = ("--model", "planar5", "--objective", "truth-rmse")
    said = sigmaswarm("tune", drives, "--out", "t", *quick, *options).out.splitlines()
    assert "  to do    " in "\n".join(said) and "  note     " not in "\n".join(said)
    asked = [line.strip().removeprefix("-> ") for line in said if line.startswith("           -> ")]
    assert any("tune with 'truth-rmse + 0.2 nees'" in line for line in asked)
    result = tomllib.loads(Path("t/tuning.toml").read_text())["result"]
    remarks = [
        r.removeprefix("TO DO: ").split(". Reason: ")[0] for r in result["remarks"] if r.startswith("TO DO")
    ]
    assert [one for one in asked if one in remarks] == remarks
    said = sigmaswarm("tune", drives, "--out", "u", *quick, *options, "--verbose").out
    assert "  note     " in said and "--verbose" not in said
    said = sigmaswarm("evaluate", "t", drives, "--verbose").out
    assert "  to do    " in said and "\n           -> tune with" in said


def test_run_explains_the_missing_beginning_and_writes_its_fixes(sigmaswarm, tuned: Path, here: Path):
    drive = make_drive(duration=60.0)
    library.write_drive(drive, "s")
    assert sigmaswarm("run", tuned, "s", "--out", "e.csv", "--before", "f.csv").code == 0
    first = pl.read_csv("e.csv")["t"][0]
    assert len(pl.read_csv("f.csv")) == np.count_nonzero(drive.gps.time < first) > 10
    library.write_drive(replace(drive, imu=at_rest_before(drive.imu, 8.0)), "stood")
    said = sigmaswarm("run", tuned, "stood", "--out", "e.csv", "--before", "f.csv", "--overwrite").out
    earlier = pl.read_csv("e.csv")["t"][0] + 8.0
    assert (
        f"the first {earlier:.1f} s have no estimate, since a filter starts at the first fix with a heading, or"
        in said
    )
    assert f"wrote f.csv: {len(pl.read_csv('f.csv'))} fixes before the start of the filter" in said
    assert sigmaswarm("run", tuned, "s", "--out", "e.csv", "--before", "f.tum").code == 2


def test_split_in_time(sigmaswarm, drives: Path, here: Path):
    ended = sigmaswarm(
        "split", drives / "urban-clear-00", "--out", "parts", "--train-fraction", 0.5, "--json"
    )
    assert json.loads(ended.out) == {"drives": ["parts/urban-clear-00-train", "parts/urban-clear-00-test"]}
    train, test = (read_drive(f"parts/urban-clear-00-{part}") for part in ("train", "test"))
    assert train.imu.time[-1] < 15 <= test.imu.time[0]
    assert len(train.imu) + len(test.imu) == len(read_drive(drives / "urban-clear-00").imu)
    refused = sigmaswarm("split", drives / "urban-clear-00", "--out", "few", "--at", 29.9)
    assert refused.code == 2 and "fixes is too short for a drive" in refused.err and not Path("few").exists()
    for time in re.search(r"from ([\d.]+) to ([\d.]+) s", refused.err).groups():
        assert (
            sigmaswarm("split", drives / "urban-clear-00", "--out", "few", "--at", time, "--overwrite").code
            == 0
        )


@pytest.mark.parametrize(
    ("at", "short", "tuned"), several([(11.0, "train", "test"), (25.0, "", "train"), (40.0, "", "train")])
)
def test_a_part_that_is_too_short_is_not_proposed(sigmaswarm, here: Path, at: float, short: str, tuned: str):
    """Less than 10 s follow the start."""
    write_drive(simulate("urban", duration=75.0, imu_rate=50.0, run=1, gps="white-1m"), "long")
    said = sigmaswarm("split", "long", "--out", "parts", "--at", at).out
    (part,) = re.findall(r"sigmaswarm tune parts/\S+-(\w+) ", said)
    assert part == tuned
    assert re.findall(r"note: \S+-(\w+) is too short for a tuning", said) == [short] * bool(short)
    assert ("sigmaswarm evaluate" in said) is not bool(short)


@pytest.mark.parametrize(("delay", "proposed"), several([(0.0, True), (0.1, True), (0.6, False)]))
def test_an_unused_velocity_is_the_next_step(sigmaswarm, here: Path, delay: float, proposed: bool):
    """Unless the velocity is delayed, the doctor and tune propose a second tuning with --verbose."""
    for name, run in {"car": 1, "held": 2}.items():
        drive = simulate("urban", duration=75.0, imu_rate=50.0, run=run, gps="white-1m")
        true, rng = drive.truth, np.random.default_rng(3)
        east, north = (np.interp(drive.gps.time - delay, true.time, v) for v in (true.vx, true.vy))
        east, north = (v + 0.05 * rng.standard_normal(len(v)) for v in (east, north))
        velocity = {"speed": np.hypot(east, north), "course": np.arctan2(north, east)}
        write_drive(replace(drive, gps=replace(drive.gps, **velocity)), name)
    tune = ("--particles", 6, "--generations", 2)
    said = [" ".join(sigmaswarm("doctor", "car", "--verbose").out.split())]
    more = ("--validation", "held") if delay == 0.1 else ()
    said.append(sigmaswarm("tune", "car", "--out", "t", "--trust-log", "--verbose", *tune, *more).out)
    assert delay != 0.1 or said[1].count("--validation held") == 1
    options = [re.findall(r"--use ([a-z -]*velocity)", text) for text in said]
    assert all(map(bool, options)) is proposed
    assert "sigmaswarm tune car --out tuned-velocity --use" in said[1] or not proposed
    if proposed and delay == 0.0:  # the command works, and afterwards nothing is proposed
        (command,) = re.findall(r"sigmaswarm (tune car --out tuned-velocity .*)", said[1])
        again = sigmaswarm(*shlex.split(command), "--verbose")
        assert again.code == 0 and "sigmaswarm tune" not in again.out


@pytest.mark.parametrize(("recorded", "others", "diagnosed"), [(5, 0, MAX_DIAGNOSED), (2, 0, 2), (4, 1, 0)])
def test_few_drives_are_diagnosed_for_an_unused_velocity(
    monkeypatch, recorded: int, others: int, diagnosed: int
):
    drive, names = simulate("cruise", gps="white-1m"), []
    speed = np.ones(len(drive.gps))
    driven = replace(drive, gps=replace(drive.gps, speed=speed, course=speed))
    use = Finding("use", "note", "write --use lateral velocity", "", (0.0, 1.0), 0.9, "")
    monkeypatch.setattr(
        "sigmaswarm.diagnose", lambda one: names.append(one.name) or Diagnosis(one.name, (use,))
    )
    read = LocalDataset([driven] * recorded + [drive] * others)
    stated = {"model": "planar8", "kind": "ekf", "use": ["standstill"], "as_recorded": True}
    started = {**stated, "start": Path("first"), "validation": ["held out", "more"]}
    said = _with_velocity(["drives"], TuneConfig(**stated), read, started)
    assert bool(said) is (diagnosed > 0)
    assert len(names) == diagnosed
    assert not said or said[0].endswith(" --start first --validation 'held out' more")
    assert not said or "--use standstill velocity --model planar8 --kind ekf --as-recorded" in said[0]


def test_a_drive_that_is_too_short_is_not_proposed(sigmaswarm, here: Path):
    whole = simulate("urban", duration=30.0, imu_rate=50.0, run=1, gps="white-1m")
    write_drive(clip(whole, 0, 18), "short")
    said = sigmaswarm("split", "short", "--out", "parts", "--at", 9).out
    assert "next: use a longer drive, or split at another time" in said and "sigmaswarm tune" not in said
    write_drive(clip(whole, 0, 9), "part")
    said = sigmaswarm("doctor", "part").out
    assert "next: use a longer drive; " in said and "sigmaswarm tune" not in said


def test_the_demo_is_the_quick_study(sigmaswarm, here: Path, monkeypatch: pytest.MonkeyPatch):
    """The demo is shortened by a smaller swarm and fewer drives; a second demo continues the first."""
    small = {"maneuvers": ("turns", "brake"), "environments": ("clear",)}
    small |= {"particles": 6, "generations": 3, "trials": 2}
    monkeypatch.setattr("sigmaswarm.cli.study.QUICK_STUDY", study_config.QUICK_STUDY | small)
    ended = sigmaswarm("demo", "--out", "show")
    assert ended.code == 0
    for words in (
        "**Table I. RMSE, m**",
        "| PSO-UKF (tuned with the fixes) | 0.50 | ",
        "| EKF, manual: data sheet | 7.45 [7.22, 7.68] |",
        "| default filter of tune (tuned with truth) |",
        "| UKF | 1.20 |",
        "**Parameters of the best trial**",
        "page:    show/page.html\nnext:    sigmaswarm import LOG --show ",
    ):
        assert words in ended.out
    assert "DRIVE..." not in ended.out  # the filters are for simulated sensors
    results = json.loads(Path("show/results.json").read_text())
    assert (results["drives"]["count"], results["config"]["trials"]) == (4, 2)

    def mean(protocol: str, method: str, measure: str) -> float:
        at = {"protocol": protocol, "method": method, "measure": measure, "maneuver": "all"}
        return next(r["mean"] for r in results["summary"] if at.items() <= r.items())

    why = next(line for line in ended.out.splitlines() if line.startswith("The study has two objectives"))
    for figures in (
        ("paper", "pso-ukf", "gps_rmse_m"),
        ("paper", "pso-ukf", "position_rmse_m"),
        ("untuned", "raw-gps", "position_rmse_m"),
        ("honest", "pso-ukf", "position_rmse_m"),
    ):
        assert f"{mean(*figures):.2f} m" in why
    assert all(Path(f"show/figures/{name}.png").exists() for name in ("convergence", "trajectory"))
    assert "The study has two objectives" in Path("show/page.html").read_text()
    again = sigmaswarm("demo", "--out", "show")
    assert again.code == 0
    assert json.loads(Path("show/results.json").read_text()) == results
    assert sigmaswarm("demo", "--out", "show", "--seed", "1").code == 2


@pytest.mark.long
def test_scores_on_training_drives_are_marked(sigmaswarm, drives: Path, here: Path):
    first, second = sorted(drives.iterdir())[:2]
    assert sigmaswarm("split", first, "--out", "parts", "--train-fraction", 0.8).code == 0
    cut = tomllib.loads(Path("parts/urban-clear-00-test/drive.toml").read_text())["cut_from"]
    assert (cut["drive"], round(cut["start_s"])) == ("urban-clear-00", 24)
    tune = ("tune", "parts/urban-clear-00-train", *QUICK, "--model", "planar5")
    assert sigmaswarm(*tune, "--out", "part").code == 0
    told = sigmaswarm("evaluate", "part", first, "--json").err
    assert (
        "the tuning used 24 of the 30 s of urban-clear-00, as urban-clear-00-train: the errors on training"
        in told
    )
    said = sigmaswarm("evaluate", "part", first, "--out", "e").out
    sentence = "On 1 drive (TRAINING DATA: the tuning used 24 of the 30 s of urban-clear-00, as urban-clear-00-train)"
    assert said.startswith(sentence)
    assert sigmaswarm("report", "e").code == 0
    assert sentence in Path("e/page.html").read_text()
    shutil.copytree("part", "alone")
    Path("alone/seen.npz").unlink()  # without this file, only whole drives are recognized
    plain = "On 1 drive, the tuned filter"
    assert sigmaswarm("evaluate", "alone", first, "--out", "f").out.startswith(
        "Scores on 1 drive (lower is better)"
    )
    assert sigmaswarm("report", "f").code == 0
    assert plain in Path("f/page.html").read_text()
    told = sigmaswarm("evaluate", "alone", second, "parts/urban-clear-00-train").out
    assert told.startswith(
        "On 2 drives (PARTLY TRAINING DATA: the tuning used all of the 24 s of urban-clear-00-train)"
    )
    shutil.copy("part/tuning.toml", "part/mine.txt")  # a filter file can have any name
    ended = sigmaswarm("evaluate", "part/mine.txt", second)
    assert ended.code == 0, ended.err
    ended = sigmaswarm(*tune, "--out", "no", "--validation", first)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "24 s of this drive are also in the training drives (urban-clear-00-train)" in ended.err
    assert sigmaswarm("evaluate", "part", second).out.startswith("On 1 drive that the tuning did not use")


@pytest.mark.usefixtures("unoptimized")
def test_proposed_commands_for_one_log_can_be_pasted(sigmaswarm, drives: Path, here: Path):
    """Also if the user named the parent folder of the drive, and if names contain blanks."""
    drive = replace(read_drive(min(drives.iterdir())), name="it's monday")
    write_drive(drive, Path("my logs/monday"))
    told = sigmaswarm("tune", "my logs", "--out", "my filter", *QUICK).out
    assert "next: sigmaswarm evaluate 'my filter' HELD_OUT_DRIVE..." in told
    (split,) = re.findall(r"sigmaswarm (split .*)", told)
    assert sigmaswarm(*shlex.split(split)).code == 0
    (parts,) = re.findall(r"then tune on (.*), and evaluate on (.*)", told)
    train, test = (shlex.split(part)[0] for part in parts)
    told = sigmaswarm("tune", train, "--out", "t", *QUICK).out
    (command,) = re.findall(r"next: sigmaswarm (evaluate .*)", told)
    assert shlex.split(command) == ["evaluate", "t", test, "--out", "evaluation"]
    told = sigmaswarm(*shlex.split(command)).out
    report, export = re.findall(r"^(?:next|then): sigmaswarm (.*)", told, re.MULTILINE)
    assert report == "report evaluation"
    assert (
        export == f"export t --to c99 --out filter-c --replay {shlex.quote(test)} --check {shlex.quote(test)}"
    )
    assert sigmaswarm(*shlex.split(export)).code == 0
    assert (Path(test) / "imu.csv").exists()


def test_readme_states_that_raw_gps_and_the_imu_alone_need_truth(
    sigmaswarm, tuned: Path, drives: Path, here: Path
):
    drive = read_drive(min(drives.iterdir()))
    write_drive(replace(drive, truth=None), here / "plain")
    with_truth, without = (
        sigmaswarm("evaluate", tuned, place).out for place in (min(drives.iterdir()), "plain")
    )
    for method in ("raw GPS", "IMU only"):
        assert method in with_truth and method not in without
    assert (
        "if the drive has truth, raw GPS and dead reckoning"
        in (Path(__file__).parents[2] / "README.md").read_text()
    )


@pytest.mark.parametrize(
    ("option", "columns"), [("accuracy", "std_x and std_y"), ("velocity", "speed and course")]
)
def test_a_drive_can_not_use_columns_that_it_lacks(sigmaswarm, here: Path, option: str, columns: str):
    write_drive(make_drive(duration=20.0), here / "plain")
    ended = sigmaswarm("tune", "plain", "--out", "t", "--use", option)
    assert ended.code == 2
    assert f"no {columns}, which --use {option} needs; omit {option}" in ended.err
    assert not (here / "t").exists()


def test_tune_states_the_selected_filter_and_the_reason(sigmaswarm, here: Path):
    drive = make_drive(duration=20.0)
    write_drive(replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None)), here / "plain")
    said = sigmaswarm("tune", "plain", "--out", "t", *QUICK).out
    because = "an IMU lacks az, gx or gy"
    assert said.splitlines()[0] == f"model: planar8 with lateral, standstill, robust, since {because}{NAMES}"
    said = sigmaswarm("tune", "plain", "--out", "u", "--use", "lateral", *QUICK).out
    assert said.splitlines()[0] == f"model: planar8 with lateral (as given), since {because}{NAMES}"
    ended = sigmaswarm("tune", "plain", "--out", "v", "--model", "planar8", "--use-nothing", *QUICK)
    assert "model:" not in ended.out  # the user has named all options
    assert tomllib.loads(Path("v/tuning.toml").read_text())["config"]["use"] == []
    assert "model:" not in sigmaswarm("tune", "plain", "--out", "w", *QUICK, "--json").out


def test_drives_of_different_vehicles_are_reported_once(sigmaswarm, drives: Path, here: Path):
    write_drive(make_drive(duration=30.0, imu_rate=25.0, name="bus"), here / "bus")
    ended = sigmaswarm("tune", drives / "urban-clear-00", "bus", "--out", "t", *QUICK, "--model", "planar5")
    assert (ended.code, ended.err.count("different vehicles or sensors: the rate of the IMU is ")) == (0, 1)
    alone = sigmaswarm("tune", drives, "--out", "u", *QUICK, "--model", "planar5")
    assert "different vehicles" not in alone.err


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_an_evaluation_on_other_sensors_is_reported(
    sigmaswarm, tuned: Path, drives: Path, here: Path, rate: float
):
    drive = read_drive(min(drives.iterdir()))
    samples = round(rate * len(drive.imu))
    about = {"name": "monday", "duration_s": drive.duration, "imu_samples": samples, "fixes": len(drive.gps)}
    Path("t.toml").write_text(f"{tuned.read_text()}\n[[data]]\n{tomli_w.dumps(about)}")
    ended = sigmaswarm("evaluate", "t.toml", min(drives.iterdir()))
    assert ended.code == 0
    said = f"Hz instead of {samples / drive.duration:.3g} Hz). The filter can be far less accurate on this drive than"
    assert (said in " ".join(ended.err.split())) == (rate > 1)
