"""The filter bank on the command line: output of `run`, and the row of `evaluate` and its page."""

import json
from pathlib import Path

import numpy as np
import polars as pl

from sigmaswarm.drives.reader import read_drive
from sigmaswarm.filters.bank.run import run_bank
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.scoring.tracks import load_tracks


def test_run_writes_the_mixture_and_the_log_of_the_bank(sigmaswarm, drives: Path, tuned: Path, here: Path):
    drive = next(drives.iterdir())
    ended = sigmaswarm("run", tuned, drive, "--out", "estimate.csv", "--bank", "--json")
    assert ended.code == 0
    told = json.loads(ended.out)
    table, p = pl.read_csv(here / "estimate.csv"), FilterParameters.load(tuned)
    whole = run_bank(read_drive(drive), p)
    np.testing.assert_allclose(table["x"].to_numpy(), whole.mean[:, 0], rtol=1e-12)
    np.testing.assert_allclose(table["std_theta"].to_numpy(), np.sqrt(whole.covariance[:, 4, 4]), rtol=1e-9)
    assert told["said"] == told["warnings"]
    said = pl.read_csv(told["swarm"])
    assert np.ptp(np.diff(said["t"].to_numpy())) < 0.1  # one row per second
    np.testing.assert_allclose(said.select(pl.sum_horizontal("^weight_.*$")).to_series(), 1.0)
    settled = FilterParameters.load(told["settled"])
    assert (settled.model, settled.kind) == (p.model, p.kind)
    assert settled.process_noise != p.process_noise
    assert sigmaswarm("run", told["settled"], drive, "--out", "again.csv").code == 0


def test_evaluate_and_its_page_have_a_row(sigmaswarm, drives: Path, tuned: Path, here: Path):
    drive = next(drives.iterdir())
    ended = sigmaswarm("evaluate", tuned, drive, "--bank", "--out", "evaluation")
    assert ended.code == 0
    assert "tuned, filter bank" in ended.out
    scores = json.loads((here / "evaluation" / "scores.json").read_text())
    (row,) = (methods["swarm"] for methods in scores["drives"].values())
    read = read_drive(drive)
    score = score_estimate(read, run_bank(read, FilterParameters.load(tuned)))
    assert row["position_rmse_m"] == score.position_rmse
    assert row["outage_drift_m"] > 0
    (tracks,) = load_tracks(here / "evaluation" / "tracks.npz")
    assert "other receivers" in tracks.series["swarm.shares"]
    shares = [v for name, v in tracks.series["swarm.shares"].items() if name != "time"]
    np.testing.assert_allclose(np.sum(shares, axis=0), 1.0, rtol=1e-6)
    assert sigmaswarm("report", "evaluation").code == 0
    page = (here / "evaluation" / "page.html").read_text()
    assert "Filter bank" in page
    assert "--bank" in page


def test_a_bank_is_not_smoothed(sigmaswarm, drives: Path, tuned: Path):
    ended = sigmaswarm("run", tuned, next(drives.iterdir()), "--out", "e.csv", "--swarm", "--smooth")
    assert ended.code == 2
    assert "omit one option" in ended.err


def test_the_tuning_is_not_replaced(sigmaswarm, drives: Path, tuned: Path, here: Path):
    before = tuned.read_bytes() if tuned.is_file() else (tuned / "tuning.toml").read_bytes()
    Path("e.swarm.toml").write_bytes(before)
    ended = sigmaswarm(
        "run", "e.swarm.toml", min(drives.iterdir()), "--out", "e.csv", "--bank", "--overwrite"
    )
    assert ended.code == 2 and "e.swarm.toml: is another input or output of this command" in ended.err
    assert Path("e.swarm.toml").read_bytes() == before
