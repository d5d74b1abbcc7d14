"""The page of a study: values of the paper and of the study, and drives that were not used for tuning."""

import csv
import json
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from browsing import Opened
from sigmaswarm.cli.app import app
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import StudyConfig
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.record import read_quantiles
from sigmaswarm.experiments.study.scores import MAX_TRACK_POINTS, tracked_drives
from sigmaswarm.experiments.study.study import Study, run_study, shown_trial
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.run import run_filter
from sigmaswarm.reports.figures import Chart, figure_of
from sigmaswarm.reports.page import Section
from sigmaswarm.reports.page import page as html_page
from sigmaswarm.reports.read import read_report
from sigmaswarm.scoring.tracks import load_tracks
from support import make_drive

CONFIG = StudyConfig(
    maneuvers=("cruise", "turns"), environments=("clear",), runs=4, trials=2, particles=3, generations=4
)
PLOTS = 4 + 4 + 2 + 2
"""Means, boxes, a track and its errors, convergence."""


@pytest.fixture(scope="module")
def study(quick_study: None, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return run_study(CONFIG, tmp_path_factory.mktemp("page") / "study")


@pytest.fixture
def copy(tmp_path: Path, study: Study) -> Path:
    return Path(shutil.copytree(study.folder, tmp_path / "copy"))


def axes_of(chart: Chart) -> Axes:
    return figure_of(chart, size=(4, 3)).axes[0]


def section(folder: Path, title: str) -> Section:
    return next(s for s in read_report(folder).sections if s.title == title)


# ---- tracks.npz ----


@pytest.mark.long
def test_tracks_are_of_held_out_drives(study: Study):
    costs = [study.trials[Task("honest", "pso-ukf", "all", trial)].cost for trial in range(CONFIG.trials)]
    best = int(np.argmin(costs))
    tracks = load_tracks(study.folder / "tracks.npz")
    held_out = {study.design.drives[i].name: i for i in study.design.split(best)[1]}
    assert {t.name for t in tracks} <= set(held_out)
    assert [study.design.conditions[held_out[t.name]][0] for t in tracks] == ["turns", "cruise"]
    drive = study.design.drives[held_out[tracks[0].name]]
    for series, parameters in {
        "honest-pso-ukf": study.parameters[Task("honest", "pso-ukf", "all", best)],
        "paper-pso-ukf": study.parameters[Task("paper", "pso-ukf", "all", best)],
        "honest-pso-planar8": study.parameters[Task("honest", "pso-planar8", "all", best)],
        "ukf-defaults": DEFAULTS,
    }.items():
        estimate, kept = run_filter(drive, parameters), tracks[0].series[series]
        at = np.searchsorted(estimate.time, kept["time"])
        np.testing.assert_array_equal(estimate.time[at], kept["time"])
        np.testing.assert_allclose(kept["x"], estimate.mean[at, 0], rtol=1e-6, atol=1e-4)
        assert len(kept["time"]) <= MAX_TRACK_POINTS


def test_one_drive_of_each_condition_or_maneuver_is_shown():
    def shown(conditions: list[tuple[str, str]]) -> list[tuple[str, str]]:
        drives = tuple(make_drive(duration=1.0, name=f"{i:03d}") for i in range(len(conditions)))
        strata = tuple("-".join(c) for c in conditions)
        design = Design(drives, tuple(conditions), strata, CONFIG)
        chosen = tracked_drives(design, 1)
        assert set(chosen) <= set(design.split(1)[1])
        return [conditions[i] for i in chosen]

    few = [(m, e) for m in "ab" for e in "xy" for _ in range(4)]
    assert shown(few) == [("a", "x"), ("a", "y"), ("b", "x"), ("b", "y")]
    many = [(m, e) for m in "abcd" for e in "wxyz" for _ in range(4)]
    assert shown(many) == [("a", "w"), ("b", "x"), ("c", "y"), ("d", "z")]
    assert shown([("all", "all")] * 60) == [("all", "all")] * 10


# ---- contents of the page ----


def test_the_page_contains_the_results_of_the_study(study: Study):
    report = read_report(study.folder)
    row = study.results.summary("honest", "pso-ukf", "position_rmse_m")
    assert row is not None
    assert f"PSO-UKF has a position RMSE of {row.mean:.3g} m" in report.lead[0]
    _, two, three = section(study.folder, "The paper's tables").tables
    intervals = (row.trial_interval, row.corrected_t_interval, row.bootstrap_interval)
    assert ("PSO-UKF (tuned with truth)", 0.5, (0.46, 0.54), row.mean, row.sd, *intervals) in two.rows
    assert two.columns[5].title == "mean +- 1.96 SD / sqrt(n)"
    heading, drift = (
        study.results.summary("untuned", "ukf-datasheet", m) for m in ("heading_rmse_deg", "outage_drift_m")
    )
    assert heading is not None
    assert drift is not None
    theirs = {row[0]: row for row in three.rows}["UKF, manual: data sheet"]
    assert (theirs[1], theirs[2], theirs[4], theirs[5]) == (2.1, heading.mean, 7.5, drift.mean)
    assert report.versions["numpy"] == np.__version__
    command, *_ = app.parse_args(shlex.split(report.command)[1:], exit_on_error=False, print_error=False)
    assert command.__name__ == "study"
    assert html_page(report).count("<svg") == PLOTS - 2


def test_table_i_contains_the_paper_s_measure_and_ours(study: Study):
    rows = {row[0]: row for row in section(study.folder, "The paper's tables").tables[0].rows}
    assert rows["raw GPS"][1:3] == (None, 0.0)
    assert rows["IMU only"][1] == 21606.59
    found = study.results.summary("paper", "pso-ukf", "gps_rmse_m")
    assert found is not None
    assert rows["PSO-UKF (tuned with the fixes)"][2] == found.mean


def test_run_times_are_next_to_the_paper_s(study: Study, copy: Path):
    timings = json.loads((study.folder / "timings.json").read_text())["live_filter"]["UKF"]
    wanted = ("UKF", 1.2)
    for call in ("predict", "predict_and_update"):
        low, median, high = (timings[f"{call}{end}"] for end in ("_low_ms", "_ms", "_high_ms"))
        assert 0 < low <= median <= high
        wanted += (median, (low, high))
    assert wanted in section(study.folder, "Run time").tables[0].rows
    (copy / "timings.json").unlink()
    assert "Run time" not in {s.title for s in read_report(copy).sections}


def test_convergence_shows_the_generation_at_which_it_settles(study: Study):
    found = section(study.folder, "Convergence")
    rows = study.results.convergence
    assert [row[1] for row in found.tables[0].rows] == [row.stable for row in rows]
    diamond = axes_of(found.charts[0]).get_lines()[-1]
    assert diamond.get_xydata().tolist() == [[rows[0].stable, rows[0].median[rows[0].stable - 1]]]


def test_boxes_contain_one_value_per_drive(study: Study):
    with (study.folder / "scores.csv").open() as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if (row["protocol"], row["method"], row["measure"]) == ("honest", "pso-ekf", "outage_drift_m")
        ]
    means = [
        np.mean([float(r["value"]) for r in rows if r["drive"] == d]) for d in {r["drive"] for r in rows}
    ]
    (quantiles,) = [
        s
        for s in read_quantiles(study.folder)
        if (s.protocol, s.method, s.measure) == ("honest", "pso-ekf", "outage_drift_m")
    ]
    found = [quantiles.low, quantiles.first, quantiles.median, quantiles.third, quantiles.high]
    assert found == pytest.approx(np.quantile(means, [0.05, 0.25, 0.5, 0.75, 0.95]))
    assert quantiles.failed == 0
    drift = axes_of(section(study.folder, "Spread over drives, and consistency").charts[2])
    place = [label.get_text() for label in drift.get_yticklabels()].index("PSO-EKF (tuned with truth)")
    (box,) = (
        b.get_path().vertices for b in drift.patches if np.isclose(b.get_path().vertices[:4, 1].mean(), place)
    )
    own = [line.get_xdata() for line in drift.get_lines() if np.isclose(np.mean(line.get_ydata()), place)]
    drawn = {*box[:, 0], *(x for xs in own for x in xs)}
    assert sorted(drawn) == sorted(found)


def test_drives_on_which_a_filter_failed_are_counted(tmp_path: Path):
    lines = ["protocol,trial,method,drive,maneuver,environment,measure,value"]
    lines += [
        f"honest,{t},pso-ukf,d{d},all,all,nis,{v}" for t, d, v in ((0, 1, 1.0), (1, 1, 3.0), (0, 2, "inf"))
    ]
    (tmp_path / "scores.csv").write_text("\n".join(lines) + "\n")
    (quantiles,) = read_quantiles(tmp_path)
    assert (quantiles.median, quantiles.failed) == (2.0, 1)


def test_an_inconsistent_filter_is_named(study: Study, copy: Path):
    results = json.loads((copy / "results.json").read_text())
    for row in results["summary"]:
        if (row["protocol"], row["method"], row["measure"]) == ("honest", "pso-ukf", "nis"):
            row["mean"] = 5.0
    for tuned in results["tunings"]:
        tuned["cost"] = 1.0 + tuned["trial"]
    (copy / "results.json").write_text(json.dumps(results))
    remarks = read_report(copy).remarks
    assert any(
        "PSO-UKF (tuned with truth): the filter is overconfident, since its mean NIS is 5" in r
        for r in remarks
    )
    assert any(
        "PSO-UKF (tuned with truth): the training costs of the tuning runs range from 1 to 2 m" in r
        for r in remarks
    )


@pytest.mark.long
def test_filters_of_each_condition_have_separate_rows(tmp_path: Path):
    config = CONFIG.model_copy(update={"per_condition": True, "generations": 2})
    done = run_study(config, tmp_path)
    found = section(tmp_path, "Convergence")
    assert [c.title for c in found.tables[0].columns][1] == "drives"
    names = axes_of(found.charts[0]).get_legend_handles_labels()[1]
    assert names == ["cruise-clear", "turns-clear"]
    turning = load_tracks(tmp_path / "tracks.npz")[0]
    assert turning.name.startswith("turns")
    drive = next(d for d in done.design.drives if d.name == turning.name)
    estimate = run_filter(
        drive, done.parameters[Task("honest", "pso-ukf", "turns-clear", shown_trial(done.trials))]
    )
    assert turning.series["honest-pso-ukf"]["x"][-1] == pytest.approx(estimate.mean[-1, 0], rel=1e-6)


# ---- incomplete folders ----

Edit = Callable[[Path], object]
MISTAKES: dict[str, tuple[Edit, str]] = {
    "foreign results": (
        lambda f: (f / "results.json").write_text("{}"),
        "results.json: config: Field required",
    ),
    "no scores": (lambda f: (f / "scores.csv").unlink(), "scores.csv: not readable"),
    "foreign scores": (lambda f: (f / "scores.csv").write_text("a,b\n1,2\n"), "scores.csv: not readable"),
    "words for numbers": (
        lambda f: (f / "scores.csv").write_text("protocol,method,measure,drive,value\na,b,c,d,e\n"),
        "scores.csv: not readable",
    ),
    "foreign timings": (
        lambda f: (f / "timings.json").write_text("[]"),
        "timings.json: the file should be a table of keys",
    ),
    "damaged tracks": (lambda f: (f / "tracks.npz").write_bytes(b"PK\3\4"), "tracks.npz: not readable"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_damaged_folder_causes_one_clear_line(copy: Path, mistake: str):
    edit, said = MISTAKES[mistake]
    edit(copy)
    with pytest.raises(InputError) as caught:
        html_page(read_report(copy))
    assert str(caught.value).startswith(f"{copy}/{said}")
    assert "\n" not in str(caught.value)


def test_a_study_without_tracks_has_a_page(copy: Path):
    (copy / "tracks.npz").unlink()
    assert [s.title for s in read_report(copy).sections if s.tracks or s.title.startswith("Tracks")] == []


# ---- in a browser ----


@pytest.fixture(scope="module")
def pages(browser, study: Study, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Opened]:
    """Return the page in a folder without other files, opened on a screen and on a phone."""
    file = tmp_path_factory.mktemp("alone") / "study.html"
    file.write_text(html_page(read_report(study.folder)))
    return {width: Opened(browser, file, width) for width in (390, 1280)}


@pytest.fixture
def opened(pages: dict[int, Opened]) -> Iterator[Callable[..., Opened]]:
    yield lambda width=1280: pages[width]
    for one in pages.values():
        one.check_silence()


@pytest.mark.parametrize("width", [390, 1280])
def test_every_plot_is_drawn_and_fits_the_screen(opened, width: int):
    page = opened(width)
    assert len(page.drawn()) == PLOTS
    assert min(page.drawn()) > 0
    assert page.width() <= width


def test_drives_methods_and_the_filter_of_the_consistency_can_be_chosen(opened, study: Study):
    page = opened()
    tracks = load_tracks(study.folder / "tracks.npz")
    assert page.run("[...document.getElementById('drive').options].map((o) => o.text)") == [
        t.name for t in tracks
    ]
    names = "document.getElementById('{}').data.map((t) => t.name)"
    first = [
        "raw GPS",
        "PSO-UKF (tuned with the fixes)",
        "PSO-UKF (tuned with truth)",
        "truth",
        "this moment",
    ]
    assert page.run(names.format("map")) == first
    page.page.check("#method-honest-pso-planar8")
    assert "PSO-UKF, planar8 (tuned with truth)" in page.run(names.format("errors"))
    page.page.select_option("#drive", index=1)
    shown = "document.getElementById('{}').data.find((t) => t.name === '{}').{}"
    honest = page.run(shown.format("map", "PSO-UKF (tuned with truth)", "x"))
    assert honest == pytest.approx(tracks[1].series["honest-pso-ukf"]["x"], abs=1e-3)
    assert len(page.run("[...document.getElementById('sigma').options]")) == 6 + 1
    page.page.select_option("#sigma", label="UKF, manual: data sheet")
    nis = page.run(shown.format("errors", "NIS", "y"))
    assert nis == pytest.approx(tracks[1].series["ukf-datasheet.nis"]["nis"], abs=1e-3)
    page.page.select_option("#sigma", label="none")
    assert not {"NIS", "3 sigma"} & set(page.run(names.format("errors")))


def test_tables_can_be_sorted_by_intervals(opened):
    table = opened().page.locator("table.sortable").nth(1)
    head = table.locator("th").nth(6)
    assert "new drives: corrected t" in head.inner_text()
    head.locator("button").click()
    cells = table.evaluate(
        "(t) => [...t.tBodies[0].rows].map((r) => [r.cells[6].dataset.value, r.cells[6].innerText])"
    )
    known = [(float(value), text) for value, text in cells if value is not None]
    assert [value for value, _ in known] == sorted(value for value, _ in known)
    assert len(known) > 10
    assert all(float(text.split(" to ")[0]) == pytest.approx(value, rel=0.01) for value, text in known)


def test_the_page_fits_on_paper(opened, tmp_path: Path):
    assert 0 < opened().width_on_paper(tmp_path / "page.pdf") <= 680
