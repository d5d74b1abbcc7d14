"""Figures: axes, and the same bytes for the same result."""

import csv
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import run_filter
from sigmaswarm.reports.evaluation import comparison, errors, save_evaluation, tracks
from sigmaswarm.reports.figures import Chart, figure_of, logarithmic, save
from sigmaswarm.reports.style import LABELS
from sigmaswarm.reports.tuning import convergence, save_tuning_figures
from sigmaswarm.scoring.evaluation import Evaluation, evaluate
from sigmaswarm.scoring.methods import MEASURES, method_names
from sigmaswarm.scoring.tracks import Picture, first_track
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.tune import tune
from support import make_drive

DRIVE = make_drive(duration=30.0, seed=1, name="monday")
GOOD = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))
BROKEN = replace(GOOD, process_noise=(1.0, 1.0, -5.0, 1.0, 1.0))


@pytest.fixture(scope="module")
def tuning() -> Tuning:
    return tune(DRIVE, model="planar5", objective="truth-rmse", particles=4, generations=5, trials=3)


@cache
def picture(drive: Drive, tuned: FilterParameters = GOOD) -> Picture:
    return first_track(drive, tuned, as_recorded=False).picture


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return evaluate(DRIVE, GOOD)


NAMES = LABELS | method_names()


def labels(figure: Figure) -> set[str]:
    legends = [*figure.legends, *(ax.get_legend() for ax in figure.axes)]
    return {text.get_text() for legend in legends if legend for text in legend.get_texts()}


def lines(ax) -> dict[str, object]:
    return {line.get_label(): line for line in ax.get_lines()}


def test_convergence_shows_best_and_median_of_every_trial(tuning: Tuning):
    figure = convergence(tuning)
    (ax,) = figure.axes
    assert ax.get_xlabel() == "generation"
    assert ax.get_ylabel() == "cost: truth-rmse"
    assert ax.get_yscale() == "log"
    assert "3 trials" in ax.get_title(loc="left")
    assert labels(figure) == {"best so far", "median of the generation"}
    drawn = [line.get_ydata() for line in ax.get_lines()]
    for trial in tuning.trials:
        assert any(np.array_equal(y, trial.best) for y in drawn)
        assert any(np.array_equal(y, trial.median) for y in drawn)
    np.testing.assert_array_equal(lines(ax)["best so far"].get_ydata(), tuning.trials[tuning.best_trial].best)
    assert ax.get_lines()[0].get_xdata().tolist() == [1, 2, 3, 4, 5]


def test_convergence_with_failures(tuning: Tuning):
    infinite = replace(tuning.trials[0], median=np.full(5, np.inf))
    save_free = convergence(replace(tuning, trials=(infinite,), best_trial=0))
    assert save_free.axes[0].get_title(loc="left") == "Convergence"


def test_tracks_show_the_whole_and_a_close_up():
    figure = tracks(picture(DRIVE), NAMES)
    whole, close = figure.axes
    for ax in (whole, close):
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("east, m", "north, m")
        assert ax.get_aspect() == 1.0
    assert whole.get_title(loc="left") == "monday"
    expected = {"raw GPS", "truth", "tuned UKF", "baseline", "filter starts"}
    assert labels(figure) == expected
    drawn = lines(whole)
    np.testing.assert_array_equal(
        drawn["truth"].get_xydata(), np.column_stack([DRIVE.truth.x, DRIVE.truth.y])
    )
    np.testing.assert_array_equal(drawn["raw GPS"].get_xydata(), np.column_stack([DRIVE.gps.x, DRIVE.gps.y]))
    np.testing.assert_array_equal(drawn["tuned UKF"].get_xydata(), run_filter(DRIVE, GOOD).mean[:, :2])
    np.testing.assert_array_equal(
        drawn["baseline"].get_xydata(), run_filter(DRIVE, baseline(DRIVE, like=GOOD)).mean[:, :2]
    )
    np.testing.assert_array_equal(drawn["filter starts"].get_xydata(), [initial_state(DRIVE).mean[:2]])
    low, high = close.get_xlim()
    assert 30 < high - low < 200  # a close-up


def test_tracks_without_truth_and_of_a_failing_filter():
    assert "truth" not in labels(tracks(picture(replace(DRIVE, truth=None)), NAMES))
    assert "tuned UKF" in labels(tracks(picture(DRIVE, BROKEN), NAMES))


def test_errors_show_position_and_heading_over_time():
    figure = errors(picture(DRIVE), NAMES)
    position, heading = figure.axes
    assert position.get_ylabel() == "position error, m"
    assert position.get_yscale() == "log"
    assert (heading.get_ylabel(), heading.get_xlabel()) == ("heading error, deg", "time t, s")
    assert position.get_title(loc="left") == "monday: error against truth"
    assert labels(figure) == {
        "3 sigma of the tuned UKF",
        "tuned UKF",
        "baseline",
    }
    estimate = run_filter(DRIVE, GOOD)
    at = np.searchsorted(DRIVE.truth.time, estimate.time)
    distance = np.hypot(estimate.mean[:, 0] - DRIVE.truth.x[at], estimate.mean[:, 1] - DRIVE.truth.y[at])
    np.testing.assert_allclose(lines(position)["tuned UKF"].get_ydata(), distance, atol=1e-9)
    turned = np.degrees(np.angle(np.exp(1j * (estimate.mean[:, 4] - DRIVE.truth.theta[at]))))
    assert any(np.allclose(line.get_ydata(), turned, atol=1e-6) for line in heading.get_lines())
    radius = 3 * np.sqrt(estimate.covariance[:, 0, 0] + estimate.covariance[:, 1, 1])
    np.testing.assert_allclose(lines(position)["3 sigma of the tuned UKF"].get_ydata(), radius, rtol=1e-9)


def test_the_axis_of_headings_follows_the_errors():
    """The scale must show an error of 1 degree, and a diverged filter must not determine it."""
    _, heading = errors(picture(DRIVE), NAMES).axes
    low, high = heading.get_ylim()
    drawn = np.concatenate([np.abs(line.get_ydata()) for line in heading.get_lines()])
    assert np.quantile(drawn, 0.95) < high == -low < 30.0
    lost = replace(GOOD, process_noise=(*GOOD.process_noise[:4], 10.0))
    assert errors(picture(DRIVE, lost), NAMES).axes[1].get_ylim() == (-30.0, 30.0)


@pytest.mark.parametrize(
    ("values", "expected"),
    [((0.27, 0.33, 1.36), {"0.2", "0.5", "1", "2"}), ((0.5, 1.1, 820.0), {"0.1", "1", "10", "100", "1000"})],
)
def test_a_logarithmic_axis_has_few_plain_numbers(values: tuple[float, ...], expected: set[str]):
    def draw(ax: Axes) -> None:
        ax.barh(range(3), values)
        logarithmic(ax.xaxis)

    figure = figure_of(Chart("", draw), size=(4, 3))
    figure.canvas.draw()
    axis = figure.axes[0].xaxis
    said = {label.get_text() for label in (*axis.get_ticklabels(), *axis.get_ticklabels(minor=True))}
    assert expected <= said | {""} and all(float(number) > 0 for number in said - {""})
    assert not any("e" in number and float(number) > 1e-3 for number in said)


def test_errors_are_drawn_only_where_truth_is_known():
    late = replace(DRIVE, truth=DRIVE.truth.select(DRIVE.truth.time > 20.0))
    drawn = lines(errors(picture(late), NAMES).axes[0])["tuned UKF"].get_xydata()
    assert np.nanmax(drawn[:, 1]) < 20.0, "errors before the start of truth are drawn"


def test_errors_need_truth():
    assert errors(picture(replace(DRIVE, truth=None)), NAMES) is None


def test_comparison_has_bars_for_every_method(evaluation: Evaluation):
    figure = comparison(evaluation)
    titles = [
        "position RMSE, m",
        "position 50%, m",
        "position 95%, m",
        "heading error, deg",
        "1 s outage drift, m",
        "5 s outage drift, m",
    ]
    assert [ax.get_title(loc="left") for ax in figure.axes] == titles
    said = evaluation.to_dict()["mean"]
    names = ["tuned UKF", "baseline", "fixes alone", "raw GPS", "IMU only"]
    shown = [m for m in MEASURES if m != "long_outage_drift_m"]  # the drive is too short for it
    for ax, measure in zip(figure.axes, shown, strict=True):
        values = [m[measure] for m in said.values()]
        known = [(n, v) for n, v in zip(names, values, strict=True) if v is not None]
        known = [(n, v) for n, v in known if n != "IMU only" or "drift" not in measure]
        assert [t.get_text() for t in ax.get_yticklabels()] == [n for n, _ in known]
        longest = 1.25 * max(v for n, v in known if n not in ("IMU only", "fixes alone"))
        beyond = [" →" * (v > longest) for _, v in known]
        assert [patch.get_width() for patch in ax.patches] == [min(v, longest) for _, v in known]
        assert [t.get_text().strip() for t in ax.texts] == [
            f"{v:.3g}{end}" for (_, v), end in zip(known, beyond, strict=True)
        ]
        assert (ax.get_xscale(), ax.get_xlim()[0]) == ("linear", 0.0)


@pytest.mark.long
def test_comparison_without_truth_has_no_empty_panels():
    blind = replace(DRIVE, truth=None)
    figure = comparison(evaluate(blind, GOOD))
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["1 s outage drift, m", "5 s outage drift, m"]
    assert all(ax.patches for ax in figure.axes)
    short = replace(make_drive(duration=12.0, seed=1, name="short"), truth=None)
    (ax,) = comparison(evaluate(short, GOOD)).axes
    assert "nothing can be compared" in ax.texts[0].get_text()
    assert not ax.axison


@pytest.mark.long
def test_every_figure_has_the_same_bytes_twice(tmp_path: Path, tuning: Tuning, evaluation: Evaluation):
    makers = {
        "convergence": lambda: convergence(tuning),
        "tracks": lambda: tracks(picture(DRIVE), NAMES),
        "errors": lambda: errors(picture(DRIVE), NAMES),
        "comparison": lambda: comparison(evaluation),
    }
    for name, make in makers.items():
        first, second = (save(make(), tmp_path / f"{name}-{i}.png").read_bytes() for i in range(2))
        assert first == second, name
        assert first.startswith(b"\x89PNG\r\n\x1a\n")


def test_the_folder_of_a_tuning_contains_history_and_pictures(tmp_path: Path, tuning: Tuning):
    pictures = save_tuning_figures(tuning, picture(DRIVE), tmp_path)
    assert {p.name for p in pictures} == {"convergence.png", "training-track.png"}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)
    with (tmp_path / "convergence.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["trial", "generation", "best_cost", "median_cost"]
    for i, trial in enumerate(tuning.trials):
        mine = [r for r in rows if r["trial"] == str(i)]
        assert [int(r["generation"]) for r in mine] == [1, 2, 3, 4, 5]
        assert [float(r["best_cost"]) for r in mine] == trial.best.tolist()
        assert [float(r["median_cost"]) for r in mine] == trial.median.tolist()


def test_an_evaluation_of_failures_is_drawn(tmp_path: Path):
    written = save_evaluation(evaluate(DRIVE, BROKEN), tmp_path / "deep" / "e")
    assert all(path.stat().st_size > 0 for path in written)
    names = {"scores.json", "scores.csv", "evaluation.json", "tracks.npz"}
    names |= {"comparison.png", "monday-track.png", "monday-error.png"}
    assert {p.name for p in written} == names


def test_drives_with_the_same_name_have_separate_pictures(tmp_path: Path, unpainted: None):
    written = save_evaluation(evaluate([DRIVE, DRIVE], GOOD), tmp_path)
    assert len(set(written)) == len(written) == 11


def test_pyplot_is_not_used():
    tracks(picture(DRIVE), NAMES)
    assert "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()
