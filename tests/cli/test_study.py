"""`sigmaswarm study` on the command line."""

import sys
from pathlib import Path

import pytest

from cli.conftest import Command
from sigmaswarm.cli.study import _next_steps

SMALL = ("--runs", 2, "--trials", 2, "--particles", 2, "--generations", 1, "--workers", 2)


@pytest.mark.long
def test_a_small_study_and_its_tables(sigmaswarm: Command, here: Path):
    (here / "study.toml").write_text('maneuvers = ["turns"]\nenvironments = ["clear"]\n')
    ended = sigmaswarm("study", "--out", "out", "--config", "study.toml", *SMALL)
    assert ended.code == 0, ended.err
    assert "Table III" in ended.out
    assert "21,607" in ended.out  # number of the paper
    for name in (
        "results.json",
        "scores.csv",
        "tables/table-2.tex",
        "figures/convergence.svg",
        "timings.json",
        "tracks.npz",
    ):
        assert (here / "out" / name).stat().st_size > 0
    (here / "out" / "page.html").unlink()
    assert sigmaswarm("report", "out").code == 0
    assert (here / "out" / "page.html").stat().st_size > 2e5


def test_a_study_of_own_drives_ends_in_an_evaluation():
    (line,) = _next_steps(own_drives=True, best=Path("out/best/honest-default.toml"))
    assert line == "next:    sigmaswarm evaluate out/best/honest-default.toml DRIVE..."


def test_mistakes_take_one_line(sigmaswarm: Command, here: Path):
    (here / "out").mkdir()
    (here / "out" / "study.toml").write_text("")
    for arguments, said in (
        (("out",), "add --resume"),
        (("new", "--config", "none.toml"), "no such file"),
        (("new", "--drives", "none"), "none"),
    ):
        ended = sigmaswarm("study", "--out", *arguments)
        assert ended.code == 2
        assert said in ended.err
        assert ended.err.count("\n") == 1


@pytest.mark.parametrize("package", ["jax", "optax"])
def test_a_missing_library_gives_one_line_before_any_work(
    package: str, sigmaswarm: Command, here: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, package, None)
    ended = sigmaswarm("study", "--out", "out", "--rivals", *SMALL)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "pip install 'sigmaswarm[learned]'" in ended.err
    assert not (here / "out").exists()


def test_mistakes_about_rivals_take_one_line(sigmaswarm: Command, here: Path):
    (here / "study.toml").write_text('maneuvers = ["turns"]\nenvironments = ["clear"]\n')
    for arguments, said in (
        (("--learn-minutes", "5"), "set rivals"),
        (("--elsewhere", "x"), "set rivals"),
        (("--rivals", "--learn-minutes", "1"), "learn_minutes"),
        (("--rivals", "--per-condition"), "omit per_condition"),
        (("--rivals", "--cluster", "local:1"), "omit the cluster"),
        (("--rivals", "--runs", "2", "--elsewhere", "none"), "none"),
    ):
        ended = sigmaswarm("study", "--out", "out", "--config", "study.toml", *arguments)
        assert ended.code == 2, arguments
        assert said in ended.err
