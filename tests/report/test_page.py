"""The page: made from a folder only, opened in a real browser, with messages about unreadable files."""

import base64
import gzip
import json
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from matplotlib.axes import Axes

from browsing import Opened
from sigmaswarm.cli.app import app
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter, run_imu_only, run_innovations
from sigmaswarm.record_files import load_record
from sigmaswarm.reports.evaluation import copy_tuning
from sigmaswarm.reports.evaluation_page import read_view
from sigmaswarm.reports.figures import Chart, figure_of, hover_id
from sigmaswarm.reports.page import Report, Section
from sigmaswarm.reports.page import page as html_page
from sigmaswarm.reports.read import read_report
from sigmaswarm.reports.tuning import STATED_OPTIONS, TUNE_DEFAULTS, save_tuning_figures, tune_command
from sigmaswarm.scoring.evaluation import Evaluation, evaluate
from sigmaswarm.scoring.methods import MEASURES, METHODS, in_sentence
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.scoring.tracks import (
    MAX_POINTS,
    Tracker,
    Tracks,
    compared,
    first_track,
    load_tracks,
    save_tracks,
)
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.defaults import with_default_guards
from sigmaswarm.tuning.record import TuningRecord
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.tune import tune
from sigmaswarm.wording import as_sentence
from support import make_drive, quickly

NASTY = '<img src=x onerror="alert(1)"></script><script>alert(2)</script> & \'Fri"day\''
MONDAY = make_drive(duration=30.0, seed=1, name="monday")
NASTY_DRIVE = make_drive(duration=40.0, seed=2, name=NASTY)
TUESDAY = make_drive(duration=30.0, seed=3, name="tuesday")
BLIND = make_drive(duration=30.0, seed=4, name="blind", truth=False)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Evaluation]:
    """Return folders of a tuning with validation and of its evaluation on two drives, and the evaluation."""
    root = tmp_path_factory.mktemp("page")
    tuned, out = root / "tuned", root / "evaluation"
    asked = {"model": "planar5", "objective": "truth-rmse", "particles": 4, "generations": 5, "trials": 2}
    tuning = tune(MONDAY, validation=TUESDAY, out=tuned, **asked)
    save_tuning_figures(tuning, first_track(MONDAY, tuning.parameters, as_recorded=False).picture, tuned)
    drives = [NASTY_DRIVE, TUESDAY]
    found = evaluate(drives, tuning.parameters)
    save(found, tuned, out)
    return tuned, out, found


def save(found: Evaluation, tuned: Path, out: Path) -> None:
    """Save like `sigmaswarm evaluate --out`, without pictures."""
    out.mkdir()
    found.save(str(out))
    copy_tuning(tuned, out)


@pytest.fixture
def copy(tmp_path: Path, folders: tuple[Path, Path, Evaluation]) -> Path:
    return Path(shutil.copytree(folders[1], tmp_path / "copy"))


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory, folders: tuple[Path, Path, Evaluation]
) -> dict[str, Path]:
    """Return the pages in a folder without other files."""
    root = tmp_path_factory.mktemp("pages")
    for name, folder in zip(("tuning", "evaluation"), folders[:2], strict=True):
        (root / f"{name}.html").write_text(html_page(read_report(folder)))
    return {name: root / f"{name}.html" for name in ("tuning", "evaluation")}


# ---- tracks.npz ----


def tracks_of(drive: Drive, filters: dict[str, FilterParameters], name: str) -> Tracks:
    ready = PreparedDrive(drive)
    tracker = Tracker(ready)
    tracker.keep_estimate("imu_only", run_imu_only(ready))
    for series, parameters in filters.items():
        tracker.record(series, tracking_pass(ready), parameters)
    return tracker.tracks(name)


def test_tracks_contain_the_estimates_of_the_filters(tmp_path: Path, folders: tuple[Path, Path, Evaluation]):
    parameters = FilterParameters.load(folders[0])
    (read,) = load_tracks(
        save_tracks([tracks_of(MONDAY, compared(MONDAY, parameters), "m")], tmp_path / "tracks.npz")
    )
    assert read.name == "m"
    assert set(read.series) == {"truth", *METHODS, "tuned.nis", "untuned.nis"} - {"fixes_alone"}
    estimate, tuned = run_filter(MONDAY, parameters), read.series["tuned"]
    at = np.searchsorted(estimate.time, tuned["time"])
    np.testing.assert_array_equal(estimate.time[at], tuned["time"])
    np.testing.assert_allclose(tuned["x"], estimate.mean[at, 0], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(tuned["y"], estimate.mean[at, 1], rtol=1e-6, atol=1e-6)
    true = np.searchsorted(MONDAY.truth.time, tuned["time"])
    distance = np.hypot(
        estimate.mean[at, 0] - MONDAY.truth.x[true], estimate.mean[at, 1] - MONDAY.truth.y[true]
    )
    np.testing.assert_allclose(tuned["position_error"], distance, rtol=1e-5, atol=1e-6)
    sigma = 3 * np.sqrt(estimate.covariance[at, 0, 0] + estimate.covariance[at, 1, 1])
    np.testing.assert_allclose(tuned["position_3sigma"], sigma, rtol=1e-6)
    heading = 3 * np.degrees(np.sqrt(estimate.covariance[at, 4, 4]))
    np.testing.assert_allclose(tuned["heading_3sigma"], heading, rtol=1e-6)
    np.testing.assert_allclose(
        read.series["tuned.nis"]["nis"], run_innovations(MONDAY, parameters).nis, rtol=1e-5
    )
    assert tuned["time"][0] > initial_state(MONDAY).time


def test_thinning_keeps_ends_and_peaks(folders: tuple[Path, Path, Evaluation]):
    parameters = FilterParameters.load(folders[0])
    estimate = run_filter(MONDAY, parameters)
    tuned = tracks_of(MONDAY, compared(MONDAY, parameters), "m").series["tuned"]
    assert len(estimate.time) > MAX_POINTS >= len(tuned["time"]) > MAX_POINTS / 2
    assert tuned["time"][[0, -1]].tolist() == estimate.time[[0, -1]].tolist()
    at = np.searchsorted(MONDAY.truth.time, estimate.time)
    distance = np.hypot(estimate.mean[:, 0] - MONDAY.truth.x[at], estimate.mean[:, 1] - MONDAY.truth.y[at])
    assert tuned["position_error"].max() == pytest.approx(distance.max(), rel=1e-6)


def test_tracks_without_truth_and_of_a_failing_filter(tmp_path: Path):
    broken = FilterParameters(0.3, 2.0, 0.0, (1.0, 1.0, -5.0, 1.0, 1.0), (1.0, 1.0))
    tracks = tracks_of(BLIND, compared(BLIND, broken), "b")
    assert "truth" not in tracks.series
    assert "position_error" not in tracks.series["tuned"]
    assert "position_3sigma" in tracks.series["tuned"]
    assert "tuned.nis" not in tracks.series
    assert "untuned.nis" in tracks.series
    save_tracks([tracks], tmp_path / "t.npz")


def test_the_files_have_the_same_bytes_twice(
    tmp_path: Path, folders: tuple[Path, Path, Evaluation], files: dict[str, Path]
):
    tuned, out, found = folders
    again = tmp_path / "again"
    save(found, tuned, again)
    for name in ("tracks.npz", "evaluation.json", "tuning.toml", "convergence.csv"):
        assert (again / name).read_bytes() == (out / name).read_bytes(), name
    assert html_page(read_report(out)) == files["evaluation"].read_text()


# ---- contents of the page ----


def test_the_other_filter_has_its_own_name(
    tmp_path: Path, folders: tuple[Path, Path, Evaluation], copy: Path
):
    """Also if the folder was written by Python or an older version, or contains against.toml of another evaluation."""
    mine = FilterParameters.load(folders[0])
    found, out = evaluate(TUESDAY, mine, against=replace(mine, kind="ekf")), tmp_path / "e"
    save(found, folders[0], out)
    assert FilterParameters.load(out / "against.toml") == replace(mine, kind="ekf")
    assert "other EKF" in repr(read_report(out))
    mine.save(out / "against.toml")
    assert "other EKF" in repr(read_report(out))
    asked = json.loads((out / "evaluation.json").read_text())
    del asked["against"]
    (out / "evaluation.json").write_text(json.dumps(asked))
    page = repr(read_report(out))
    assert "other filter" in page and "other EKF" not in page and "other UKF" not in page
    assert "other filter" not in repr(read_report(copy)), "there is no other filter"


def test_the_summary_contains_the_values_of_the_evaluation(folders: tuple[Path, Path, Evaluation]):
    _, out, found = folders
    report = read_report(out)
    said = report.lead[0]
    assert said.endswith(" on 2 drives.")  # the drives are not called held out
    assert said.startswith(
        f"The tuned filter has a position RMSE of {found.mean('tuned', 'position_rmse_m'):.3g} m, "
    )
    means = {m: found.mean(m, "position_rmse_m") for m in ("raw_gps", "fixes_alone", "untuned")}
    best = min(means, key=means.__getitem__)
    better, name = found.improvement(best), in_sentence(best, found.names[best])
    than_best = (
        f"{abs(better):.0f}% {'lower' if better >= 0 else 'HIGHER'} than {name} ({means[best]:.3g} m), on"
    )
    assert than_best in said and said.count(" than ") == 1
    view = read_view(out, load_record(TuningRecord, out / "tuning.toml"))
    assert (view.result(), view.scores) == (found.view.result(), found.view.scores), (
        "the files give the same result"
    )
    table = next(s for s in report.sections if s.title == "Comparison").tables[1]
    assert len(table.rows) == 2 * len(METHODS)
    assert table.rows[0] == (
        NASTY,
        "tuned UKF",
        *(
            found.value(NASTY, "tuned", c) for c in MEASURES if c != "long_outage_drift_m"
        ),  # the drive is too short for it
    )


def test_the_tuning_s_page_contains_every_parameter_and_remark(folders: tuple[Path, Path, Evaluation]):
    tuned, _, _ = folders
    file = tomllib.loads((tuned / "tuning.toml").read_text())
    report = read_report(tuned)
    rows = {row[0]: row for row in report.sections[0].tables[0].rows}
    assert rows["q_vx"][1:3] == (file["filter"]["process_noise"][2], "m2/s2 per nominal IMU step")
    assert rows["r_y"][1:3] == (file["filter"]["measurement_noise"][1], "m2")
    for name, ends in file["within_1_percent_of_the_cost"].items():
        assert list(rows[name][3:5]) == ["at the bound" if e == "-" else e for e in ends]
    assert report.remarks == tuple(map(as_sentence, Tuning.load(tuned).remarks))
    assert f"{file['result']['validation_cost']:.4f}" in report.lead[1]
    chart = next(s for s in report.sections if s.title == "Convergence").charts[0]
    assert len(figure_of(chart, size=(4, 3)).axes[0].get_lines()) == 4


def test_the_page_gives_both_axes_the_range_of_a_common_noise(tmp_path: Path):
    tune(MONDAY, model="planar8", particles=4, generations=2, out=tmp_path)
    path = tmp_path / "tuning.toml"
    file = tomllib.loads(path.read_text())
    file["within_1_percent_of_the_cost"]["q_vxy"] = [1e-5, "-"]
    file["result"]["touched_bounds"] = ["q_vxy at its upper bound (10)"]
    path.write_text(tomli_w.dumps(file))
    rows = {row[0]: row for row in read_report(tmp_path).sections[0].tables[0].rows}
    for name, value in zip(("q_vx", "q_vy"), file["filter"]["process_noise"][2:4], strict=True):
        assert (rows[name][1], *rows[name][3:5]) == (value, 1e-5, "at the bound")
        assert rows[name][6] == "at its upper bound (10)"
    assert [rows[name][3] for name in ("r_x", "r_y")] == [file["within_1_percent_of_the_cost"]["r_xy"][0]] * 2
    assert rows["q_theta"][6] != rows["q_vx"][6]


def test_a_tilted_filter_is_tuned_evaluated_and_shown(tmp_path: Path):
    tuned, out = tmp_path / "tuned", tmp_path / "evaluation"
    tuning = tune(MONDAY, model="tilted12", particles=4, generations=2, out=tuned)
    found = evaluate(TUESDAY, tuning.parameters)
    assert found.value("tuesday", "tuned", "position_rmse_m") < 5
    save(found, tuned, out)
    assert any("tilted12 (ekf)" in said for said in (read_report(out).title, *read_report(out).lead))
    file = tomllib.loads((tuned / "tuning.toml").read_text())
    together = {
        "q_tilt": ("q_roll", "q_pitch"),
        "q_accel_bias": ("q_accel_bias_x", "q_accel_bias_y"),
        "q_gyro_bias_xy": ("q_gyro_bias_x", "q_gyro_bias_y"),
        "q_gyro_bias_z": ("q_gyro_bias_z",),
        "q_vxy": ("q_vx", "q_vy"),
    }
    for i, name in enumerate(together):
        file["within_1_percent_of_the_cost"][name] = [1e-9 * (i + 1), "-"]
    file["result"]["touched_bounds"] = ["q_tilt at its upper bound (0.0001)"]
    (tuned / "tuning.toml").write_text(tomli_w.dumps(file))
    rows = {row[0]: row for row in read_report(tuned).sections[0].tables[0].rows}
    for i, alike in enumerate(together.values()):
        for name in alike:
            assert rows[name][3:5] == (1e-9 * (i + 1), "at the bound")
            assert ("at its upper bound" in str(rows[name][6])) == (name in together["q_tilt"])


def test_the_page_states_the_position_of_the_rear_axle(tmp_path: Path):
    tune(MONDAY, model="planar8", use=["lateral"], particles=4, generations=2, out=tmp_path)
    path = tmp_path / "tuning.toml"
    file = tomllib.loads(path.read_text())
    file["result"]["touched_bounds"] = ["rear_axle at its upper bound (4)"]
    path.write_text(tomli_w.dumps(file))
    rows = {row[0]: row for row in read_report(tmp_path).sections[0].tables[0].rows}
    said = "distance of the IMU in front of the rear axle; negative: behind the rear axle"
    assert rows["rear_axle"][2] == "m"
    assert str(rows["rear_axle"][6]).startswith(said)
    assert "rear axle" not in str(rows["lateral_noise"][6])


@pytest.mark.parametrize(("optimizer", "has_swarm"), [("de", False), ("pso", True)])
def test_the_configuration_contains_the_settings_of_its_optimizer(
    tmp_path: Path, optimizer: str, has_swarm: bool
):
    tune(MONDAY, optimizer=optimizer, particles=4, generations=2, out=tmp_path)
    config = read_report(tmp_path).config
    assert config["optimizer"] == optimizer
    for name in ("inertia", "cognitive", "social", "zero_velocity_at_bounds"):
        assert (name in config) == has_swarm


def test_training_drives_are_not_called_held_out(tmp_path: Path, folders: tuple[Path, Path, Evaluation]):
    tuned, _, _ = folders
    parameters = FilterParameters.load(tuned)
    found = evaluate([MONDAY, BLIND], parameters)
    out = tmp_path / "e"
    save(found, tuned, out)
    report = read_report(out)
    assert "on 2 drives (PARTLY TRAINING DATA: the tuning used all of the 30 s of monday)" in report.lead[0]
    assert any("expect larger errors on other drives" in remark for remark in report.remarks)
    assert "NaN" not in unpacked(html_page(report))


@pytest.mark.parametrize(
    ("code", "columns", "factor"),
    quickly(
        [
            ("gyro-sign", "gz", -1.0),
            ("gyro-unit", "gx gy gz", 180 / np.pi),
            ("accelerometer-unit", "ax ay az", 1 / 9.80665),
        ],
        lambda code, *_: code == "gyro-sign",
    ),
)
def test_faults_that_the_doctor_finds_and_an_offset_of_truth_are_on_the_page(
    tmp_path: Path, folders: tuple[Path, Path, Evaluation], code: str, columns: str, factor: float
):
    drive = simulate("urban", duration=40.0, gps="white-1m", imu_rate=50.0)
    imu = replace(drive.imu, **{n: factor * getattr(drive.imu, n) for n in columns.split()})
    truth = replace(drive.truth, x=drive.truth.x + 3.0)
    found = evaluate(replace(drive, imu=imu, truth=truth, name="friday"), FilterParameters.load(folders[0]))
    save(found, folders[0], tmp_path / "e")
    remarks = read_report(tmp_path / "e").remarks
    assert any(r.startswith(f"The doctor finds a SERIOUS fault in friday [{code}]") for r in remarks)
    assert any("m from the truth" in r and "--origin" in r for r in remarks)
    assert any("m from the truth" in r for r in found.view.sentences())


def test_without_truth_the_page_contains_the_drift_and_no_empty_columns(
    tmp_path: Path, folders: tuple[Path, Path, Evaluation]
):
    found = evaluate(BLIND, FilterParameters.load(folders[0]))
    save(found, folders[0], tmp_path / "e")
    report = read_report(tmp_path / "e")
    assert any(sentence.startswith("blind: there is no truth") for sentence in report.lead)
    for section in report.sections[:3]:
        for table in section.tables:
            for i, column in enumerate(table.columns):
                assert any(row[i] is not None for row in table.rows), column
    scores, spread = report.sections[1].tables
    assert any(" random placements; for a single placement it is" in text for text in report.sections[1].text)
    missing = "blind can't contain such an outage, which needs 40 s after the start of the filter."
    assert f"No 30 s outage drift: {missing}" in report.sections[1].text
    titles = [title for s in (1, 5) for title in ("outages", f"{s} s outage drift", "range over placements")]
    assert [c.title for c in spread.columns[2:]] == titles
    for row in spread.rows:
        for outages, drift, (low, high) in (row[2:5], row[5:8]):
            assert low <= drift <= high and outages >= 8, row
    assert [c.title for c in scores.columns] == ["drive", "method", "1 s outage drift", "5 s outage drift"]
    assert [row[1] for row in scores.rows] == ["tuned UKF", "baseline", "fixes alone"]
    assert "NEES" not in report.sections[2].text[0]
    assert not any("without truth" in sentence for sentence in read_report(folders[1]).lead)
    tuning = tmp_path / "e" / "tuning.toml"
    drifts = [(5.0, 3.0, 2.0, 9.0), (30.0, 7.13, 6.36, 59.4)]
    names = "length_s", "tuned_m", "baseline_m", "fixes_alone_m"
    forecasts = [dict(zip(names, one, strict=True)) for one in drifts]
    tuning.write_text(tomli_w.dumps(tomllib.loads(tuning.read_text()) | {"forecasts": forecasts}))
    (larger,) = (remark for remark in read_report(tmp_path / "e").remarks if "MORE" in remark)
    assert larger == (
        "On the training drives, the tuned filter drifts MORE than the baseline in outages of 30 s (7.13 m instead "
        "of 6.36 m); this evaluation has no such outages."
    )


def test_the_commands_contain_the_given_options(folders: tuple[Path, Path, Evaluation]):
    tuned, out, _ = folders
    command, bound, _ = app.parse_args(
        shlex.split(read_report(tuned).command)[1:], exit_on_error=False, print_error=False
    )
    assert command.__name__ == "tune"
    config = tomllib.loads((tuned / "tuning.toml").read_text())["config"]
    for option in ("objective", "particles", "generations", "trials", "seed", "model", "use"):
        assert bound.arguments[option] == config[option]
    assert [str(d) for d in bound.arguments["options"].validation] == ["tuesday"]
    command, bound, _ = app.parse_args(
        shlex.split(read_report(out).command)[1:], exit_on_error=False, print_error=False
    )
    assert command.__name__ == "evaluate"
    assert [str(d) for d in bound.arguments["drives"]] == [NASTY, "tuesday"]


SETTLED = {"model": "planar5", "kind": "ukf", "use": []}  # these defaults depend on the logs and the model
OTHER_THAN_USUAL = {
    "objective": "truth-pose", "worst": 0.5, "particles": 7, "generations": 9, "trials": 2, "polish": 50,
    "racing": True, "inertia": 0.6, "cognitive": 1.7, "social": 1.6, "zero_velocity_at_bounds": True, "patience": 7,
    "scale": "linear", "optimizer": "pso", "seed": 3, "model": "planar8", "kind": "ekf", "use": ["lateral", "gate"],
    "outage_seed": 4, "as_recorded": True, "prior": 0.5, "inflation": 0.2,
}  # fmt: skip
USUAL = {**TUNE_DEFAULTS, **SETTLED, "objective": "truth-rmse", "prior": 0.0, "inflation": 0.0}


@pytest.mark.parametrize("name", TUNE_DEFAULTS)
def test_a_command_names_an_option_that_is_not_at_its_default(name: str):
    asked = OTHER_THAN_USUAL[name]
    said = parsed(tune_command({**USUAL, name: asked}, ["a b"], [])[0])
    assert said == {option: USUAL[option] for option in STATED_OPTIONS} | {name: asked}


@pytest.mark.parametrize(
    "asked",
    [{}, {"prior": 0.0}, {"inflation": 0.0}, {"scale": "linear"}, {"objective": "truth-rmse", "prior": 1.0}],
)
def test_a_command_names_prior_and_inflation(asked: dict):
    config = with_default_guards(TuneConfig.model_validate({"objective": "innovation-nll", **asked}))
    said = parsed(tune_command(config.model_dump(), ["a"], [])[0])
    assert TuneConfig.model_validate(said) == config
    without = {k: v for k, v in config.model_dump().items() if k not in ("prior", "inflation")}
    said = parsed(tune_command(without, ["a"], [])[0])  # an older version without these options
    assert (said["prior"], said["inflation"]) == (0.0, 0.0)


def test_there_is_no_command_for_a_model_of_the_user():
    assert tune_command({"model": {"name": "mine"}}, [], [])[0] == ""


def parsed(line: str) -> dict:
    """Return the options that the command line parses."""
    _, bound, _ = app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)
    return {name: value for name, value in bound.arguments.items() if name in TUNE_DEFAULTS}


def unpacked(page: str) -> str:
    """Return the tracks that a page contains, as JSON."""
    return gzip.decompress(base64.b64decode(page.split('id="data">')[1].split("<")[0])).decode()


def test_a_drive_s_name_is_escaped(files: dict[str, Path]):
    text = files["evaluation"].read_text()
    assert json.loads(unpacked(text))["drives"][0]["name"] == NASTY
    assert "<img" not in text

    def draw(ax: Axes) -> None:
        ax.plot(1.0, 1.0, "o", label=NASTY, gid=hover_id(NASTY))
        ax.set_xlabel(NASTY)

    shown = html_page(Report(NASTY, (), sections=(Section(NASTY, charts=(Chart(NASTY, draw),)),)))
    assert "<img" not in shown and "<script>alert" not in shown
    assert shown.count("&lt;img src=x") == 8, "title twice, section, caption and label, axis, legend, hover"
    assert "<script>alert" not in text
    assert text.count("</html>") == 1
    assert not re.search(r'(?:src|href)="(?!data:,|#)', text.split("<script", 1)[0])


@pytest.mark.long
def test_a_page_of_many_drives_stays_below_2_mb_and_keeps_the_peaks(folders: tuple[Path, Path, Evaluation]):
    report = read_report(folders[1])
    (at,) = (i for i, section in enumerate(report.sections) if section.tracks)
    view = report.sections[at].tracks
    assert view is not None
    many = replace(view, drives=[*view.drives] * 40)
    sections = tuple(replace(s, tracks=many) if i == at else s for i, s in enumerate(report.sections))
    text = html_page(replace(report, sections=sections))
    assert len(text.encode()) < 2e6
    drawn = json.loads(unpacked(text))["drives"]
    assert len(drawn) == 80
    whole, thin = view.drives[0].series["tuned"], drawn[0]["series"]["tuned"]
    assert 50 <= len(thin["time"]) < len(whole["time"])
    assert max(thin["position_error"]) == pytest.approx(whole["position_error"].max(), abs=1e-3)
    assert [thin["time"][0], thin["time"][-1]] == pytest.approx(whole["time"][[0, -1]].tolist(), abs=1e-3)


# ---- invalid folders ----

Edit = Callable[[Path], object]
MISTAKES: dict[str, tuple[Edit, str]] = {
    "no scores": (lambda f: (f / "scores.json").write_text("{"), "scores.json: not readable"),
    "foreign scores": (
        lambda f: (f / "scores.json").write_text('{"a": 1}'),
        "scores.json: drives: Field required",
    ),
    "a list": (
        lambda f: (f / "scores.json").write_text("[1]"),
        "scores.json: the file should be a table of keys",
    ),
    "a word for a number": (
        lambda f: (f / "tuning.toml").write_text(
            '[filter]\nalpha = 1\n[result]\ncost = "x"\nobjective = "o"'
        ),
        "tuning.toml: result.cost: should be a valid number",
    ),
    "no evaluation.json": (lambda f: (f / "evaluation.json").unlink(), "evaluation.json: no such file"),
    "damaged tracks": (lambda f: (f / "tracks.npz").write_bytes(b"PK\3\4"), "tracks.npz: not readable"),
    "no tracks": (lambda f: (f / "tracks.npz").unlink(), "tracks.npz: not readable"),
    "other tracks": (
        lambda f: save_tracks(load_tracks(f / "tracks.npz")[:1], f / "tracks.npz"),
        "contain different drives",
    ),
    "binary": (lambda f: (f / "tuning.toml").write_bytes(b"\xff\xfe\0"), "tuning.toml: not readable"),
    "no history": (
        lambda f: (f / "convergence.csv").write_text("a,b\n1,2\n"),
        "convergence.csv: not readable",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_damaged_folder_causes_one_clear_line(copy: Path, mistake: str):
    edit, said = MISTAKES[mistake]
    edit(copy)
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        html_page(read_report(copy))
    assert str(caught.value).startswith(str(copy))
    assert "\n" not in str(caught.value)


def test_a_folder_with_other_files(tmp_path: Path, folders: tuple[Path, Path, Evaluation]):
    with pytest.raises(InputError, match="contains no results"):
        read_report(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read_report(tmp_path / "nowhere")
    with pytest.raises(InputError, match="is a file"):
        read_report(folders[0] / "tuning.toml")
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "checkpoint-000.npz").write_bytes(b"")
    with pytest.raises(InputError, match="not finished"):
        read_report(tmp_path)
    (tmp_path / "tuning.toml").write_text("[filter]\nalpha = 1.0\n")
    with pytest.raises(InputError, match=re.escape("no [result] table")):
        read_report(tmp_path)


# ---- in a browser ----


def east(page: Opened) -> list[float]:
    """Return the x values of the tuned filter in the map."""
    return page.run("document.getElementById('map').data.find((t) => t.name === 'tuned UKF').x")


@pytest.fixture(scope="module")
def pages(browser, files: dict[str, Path]) -> dict[tuple[str, int], Opened]:
    """Open every page once at each width, since 5 MB take a second or two."""
    return {(name, width): Opened(browser, files[name], width) for name in files for width in (390, 1280)}


@pytest.fixture
def opened(pages: dict[tuple[str, int], Opened]) -> Iterator[Callable[..., Opened]]:
    """Return a page; at the end, check that no page had an error or requested another file."""
    yield lambda name, width=1280: pages[name, width]
    for one in pages.values():
        one.check_silence()


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize(
    ("name", "plots"), quickly([("tuning", 1), ("evaluation", 9)], lambda name, _: name == "evaluation")
)
def test_every_plot_is_drawn_and_fits_the_screen(opened, name: str, plots: int, width: int):
    page = opened(name, width)
    assert len(page.drawn()) == plots
    assert min(page.drawn()) > 0
    assert page.width() <= width


def test_drives_and_methods_can_be_chosen(opened):
    page = opened("evaluation")
    page.page.select_option("#drive", index=0)
    assert page.run("[...document.getElementById('drive').options].map((o) => o.text)") == [NASTY, "tuesday"]
    before = east(page)
    page.page.select_option("#drive", label="tuesday")
    after = east(page)
    assert after != before
    names = "new Set(document.getElementById('{}').data.map((t) => t.name))"
    for figure in ("map", "errors"):
        assert page.run(f"[...{names.format(figure)}].includes('IMU only')") is False
    page.page.check("#method-imu_only")
    page.page.uncheck("#method-raw_gps")
    for figure in ("map", "errors"):
        assert page.run(f"[...{names.format(figure)}].includes('IMU only')") is True
        assert page.run(f"[...{names.format(figure)}].includes('raw GPS')") is False
    page.page.select_option("#sigma", label="none")
    assert page.run(f"[...{names.format('errors')}].includes('3 sigma')") is False


def test_zooming_in_time_moves_all_panels_and_the_track(opened):
    page = opened("evaluation")
    page.page.select_option("#drive", index=0)
    whole = east(page)
    plot = page.page.locator("#errors .nsewdrag").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.page.mouse.move(box["x"] + 0.4 * box["width"], middle)
    page.page.mouse.down()
    page.page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=8)
    page.page.mouse.up()
    page.settle()
    low, high = page.run("document.getElementById('errors').layout.xaxis.range")
    assert 0 < low < high < 40
    shown = [float(page.page.input_value(f"#{end}")) for end in ("from", "to")]
    assert shown == pytest.approx([low, high], abs=0.01)
    times = page.run("document.getElementById('map').data.find((t) => t.name === 'tuned UKF').customdata")
    assert 0 < len(times) < len(whole)
    assert low <= min(times) < low + 0.5 and high - 0.5 < max(times) <= high
    assert page.run("new Set(document.getElementById('errors').data.map((t) => t.xaxis ?? 'x')).size") == 1
    page.page.click("#whole")
    assert east(page) == whole
    page.page.fill("#from", "10")
    page.page.fill("#to", "12")
    page.page.keyboard.press("Tab")
    page.settle()
    assert page.run("document.getElementById('errors').layout.xaxis.range") == [10, 12]
    assert 0 < len(east(page)) < len(whole) / 4


def test_tables_can_be_sorted_by_number_in_both_directions(opened):
    page = opened("evaluation")
    table = page.page.locator("table.sortable").nth(1)
    head = table.locator("th").nth(5)
    column = "(t) => [...t.tBodies[0].rows].map((r) => r.cells[5].dataset.value ?? null)"
    head.locator("button").click()
    values = table.evaluate(column)
    known = [float(v) for v in values if v is not None]
    assert known == sorted(known)
    assert len(known) == 8
    assert values[len(known) :] == [None, None]
    assert head.get_attribute("aria-sort") == "ascending"
    head.locator("button").click()
    values = table.evaluate(column)
    assert [float(v) for v in values if v is not None] == known[::-1]
    assert values[-2:] == [None, None]
    assert head.get_attribute("aria-sort") == "descending"


def test_the_command_is_copied(opened, folders: tuple[Path, Path, Evaluation]):
    page = opened("tuning")
    page.page.click("#copy")
    page.page.wait_for_selector("#copy:text-is('Copied')")
    assert page.run("navigator.clipboard.readText()") == read_report(folders[0]).command


def test_the_page_fits_on_paper(opened, tmp_path: Path):
    assert 0 < opened("evaluation").width_on_paper(tmp_path / "page.pdf") <= 680
