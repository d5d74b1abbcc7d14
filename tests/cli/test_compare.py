"""`sigmaswarm compare`, and the messages of `tune` on racing and on the paper's setting."""

import tomllib
from pathlib import Path

import polars as pl


def test_compare_writes_and_prints_its_table(sigmaswarm, drives: Path, here: Path):
    few = ["--seeds", 2, "--particles", 6, "--generations", 3]
    asked = ["--optimizers", "pso", "de:racing=true", "--scales", "log10", "linear", *few]
    one, other = sorted(drives.iterdir())
    ended = sigmaswarm("compare", one, *asked, "--validation", other, "--out", "c")
    assert ended.code == 0, ended.err
    assert ended.out.startswith(
        "model: tilted12 with lateral, standstill, robust, since the IMU has six axes\n"
    )
    assert (here / "c/comparison.md").read_text().strip() in ended.out
    frame = pl.read_csv(here / "c/comparison.csv")
    assert frame["optimizer"].to_list() == ["pso", "de:racing=true"] * 2
    assert frame["scale"].to_list() == ["log10"] * 2 + ["linear"] * 2
    assert (here / "c/comparison.png").exists()
    again = sigmaswarm("compare", one, *asked, "--validation", other, "--out", "c", "--resume")
    assert (again.code, again.out) == (0, ended.out)


def test_tune_reports_what_racing_saved(sigmaswarm, drives: Path, here: Path):
    ended = sigmaswarm(
        "tune", drives, "--out", "t", "--racing", "--particles", 8, "--generations", 2, "--verbose"
    )
    assert ended.code == 0, ended.err
    assert "racing: " in ended.out
    result = tomllib.loads((here / "t/tuning.toml").read_text())["result"]
    assert result["filter_steps"] / result["filter_steps_without_racing"] < 0.8


def test_tune_as_in_the_paper(sigmaswarm, drives: Path, here: Path):
    ended = sigmaswarm("tune", drives, "--out", "t", "--paper", "--scale", "linear")
    assert ended.code == 0, ended.err
    assert "warning: gps-rmse" in ended.err
    config = tomllib.loads((here / "t/tuning.toml").read_text())["config"]
    assert (config["scale"], config["objective"], config["particles"]) == ("linear", "gps-rmse", 30)
