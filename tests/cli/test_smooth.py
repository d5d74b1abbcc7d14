"""Smoothing on the command line: output of `run`, and the row of `evaluate` and its page."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.scoring.evaluation import evaluate
from sigmaswarm.scoring.score import score_estimate, truth_at
from sigmaswarm.scoring.targets import outage_windows, placements
from sigmaswarm.scoring.tracks import load_tracks


def test_run_writes_the_smoothed_estimates(sigmaswarm, drives: Path, tuned: Path, here: Path):
    drive = next(drives.iterdir())
    ended = sigmaswarm("run", tuned, drive, "--out", "smoothed.csv", "--smooth")
    assert ended.code == 0
    assert "smoothed estimates" in ended.out
    table, whole = pl.read_csv(here / "smoothed.csv"), smooth(read_drive(drive), FilterParameters.load(tuned))
    np.testing.assert_allclose(table["x"].to_numpy(), whole.mean[:, 0], rtol=1e-12)
    np.testing.assert_allclose(table["std_theta"].to_numpy(), np.sqrt(whole.covariance[:, 4, 4]), rtol=1e-9)
    causal = run_filter(read_drive(drive), FilterParameters.load(tuned))
    assert np.mean(whole.covariance[:, 0, 0]) < 0.6 * np.mean(causal.covariance[:, 0, 0])


def test_evaluate_and_its_page_have_a_row(sigmaswarm, drives: Path, tuned: Path, here: Path):
    drive = next(drives.iterdir())
    ended = sigmaswarm("evaluate", tuned, drive, "--smooth", "--out", "evaluation")
    assert ended.code == 0
    assert "tuned, smoothed" in ended.out
    scores = json.loads((here / "evaluation" / "scores.json").read_text())
    (row,) = (methods["smoothed"] for methods in scores["drives"].values())
    (tuned_row,) = (methods["tuned"] for methods in scores["drives"].values())
    assert row["position_rmse_m"] < tuned_row["position_rmse_m"]
    assert row["outage_drift_m"] < 0.7 * tuned_row["outage_drift_m"]
    (tracks,) = load_tracks(here / "evaluation" / "tracks.npz")
    sigma = [np.nanmean(tracks.series[name]["position_3sigma"]) for name in ("smoothed", "tuned")]
    assert sigma[0] < 0.8 * sigma[1]
    assert sigmaswarm("report", "evaluation").code == 0
    page = (here / "evaluation" / "page.html").read_text()
    assert "tuned, smoothed" in page
    assert "--smooth" in page
    plain = sigmaswarm("evaluate", tuned, drive)
    assert "smoothed" not in plain.out


@pytest.mark.parametrize("with_truth", [True, False])
def test_the_scores_equal_those_of_the_estimates(drives: Path, tuned: Path, with_truth: bool):
    drive, p = read_drive(next(drives.iterdir())), FilterParameters.load(tuned)
    drive = drive if with_truth else replace(drive, truth=None)
    found = evaluate(drive, p, smooth=True, outage_length=4.0)
    score = found.drives[drive.name].scores["smoothed"]
    ready = PreparedDrive(drive)
    if with_truth:
        plain = score_estimate(drive, smooth(drive, p))
        for name in ("position_rmse", "position_median", "position_95", "heading_rmse"):
            assert getattr(score, name) == pytest.approx(getattr(plain, name), rel=1e-9)
    else:
        assert np.isnan(score.position_rmse)
    squares = []
    for seed in placements(drive, ready.initial, length=4.0, seed=0):
        windows = outage_windows(drive, ready.initial, length=4.0, seed=seed)
        seen = replace(drive, gps=drive.gps.select(~hidden_fixes(drive.gps.time, windows)))
        estimate = smooth(seen, replace(p, nominal_interval=0.02), initial=ready.initial)
        ends = windows[:, 1]
        if drive.truth is not None:
            x, y = truth_at(drive.truth, ends)
        else:
            x, y = (np.interp(ends, drive.gps.time, column) for column in (drive.gps.x, drive.gps.y))
        at = [np.interp(ends, estimate.time, estimate.mean[:, i]) for i in (0, 1)]
        squares.append((at[0] - x) ** 2 + (at[1] - y) ** 2)
    assert score.outage_drift == pytest.approx(np.sqrt(np.mean(np.concatenate(squares))), rel=1e-6)
