"""Public names, signatures and shapes that other programs use."""

import inspect
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.cli.compare import compare
from sigmaswarm.cli.tune import tune
from sigmaswarm.files import RESULT_FILE
from sigmaswarm.tuning.config import CompareOptions, Option, TuneConfig, TuneOptions
from support import make_drive

PROMISED = [
    "read_drive",
    "write_drive",
    "FilterParameters",
    "import_log",
    "run",
    "Estimate",
    "run_batch",
    "export",
    "report",
    "plot",
    "tune",
    "Tuning",
    "evaluate",
]
DRIVE = make_drive(duration=15.0)
SET = sigmaswarm.FilterParameters(0.1, 2.0, 0.0, [1.0] * 5, [1.0] * 2)


def test_every_public_name_is_there():
    assert set(PROMISED) <= set(sigmaswarm.__all__)
    assert sorted(sigmaswarm.__all__) == sigmaswarm.__all__
    for name in sigmaswarm.__all__:
        assert getattr(sigmaswarm, name).__doc__, name
    assert {*sigmaswarm.__all__, "__version__", "__doc__"} == set(dir(sigmaswarm))
    nouns = [name for name in sigmaswarm.__all__ if not name.endswith(("Error", "Warning"))]
    assert len(nouns) <= 25


def test_one_call_for_each_job_of_the_command_line(tmp_path):
    drive = sigmaswarm.simulate("urban", duration=40, gps="white-1m", imu_rate=50.0)
    tuning = sigmaswarm.tune(drive, model="planar5", particles=4, generations=3, trials=1, seed=1)
    plain = sigmaswarm.run(drive, tuning)
    tuning.save(tmp_path / "tuning.toml")
    np.testing.assert_array_equal(plain.mean, sigmaswarm.run(drive, tmp_path / "tuning.toml").mean)
    np.testing.assert_array_equal(plain.mean, sigmaswarm.run_filter(drive, tuning.parameters).mean)
    assert not np.array_equal(sigmaswarm.run(drive, tuning, smooth=True).mean, plain.mean)
    with pytest.raises(sigmaswarm.InputError, match="can't be combined"):
        sigmaswarm.run(drive, tuning, smooth=True, bank=True)
    evaluation = sigmaswarm.evaluate(drive, tuning)
    assert evaluation.drives[drive.name].record.seen_s  # the drive was used by the tuning
    for result in (evaluation, tuning):
        assert sigmaswarm.report(result, tmp_path / "page.html").startswith("<!doctype html>")
        assert sigmaswarm.plot(result).axes
        assert str(result).count("\n") < 15
    assert sigmaswarm.plot(drive).axes
    assert sigmaswarm.plot(evaluation, drive.name).axes
    texts = sigmaswarm.export(tuning, "c99", tmp_path / "c")
    written = {path.name for path in (tmp_path / "c").iterdir() if path.is_file()}
    assert written == {RESULT_FILE, *(n for n in texts if "/" not in n)}
    for call in (sigmaswarm.run, sigmaswarm.evaluate):
        with pytest.raises(sigmaswarm.InputError, match="FilterParameters"):
            call(drive, 3)


def test_an_import_and_a_look_take_the_settings_of_the_command_line(tmp_path):
    t = np.arange(0, 40, 0.02)
    rows = [f"{a:.2f},0.0,0.0,0.0,{50 + 1e-6 * a:.8f},{8 + 2e-4 * a:.8f}" for a in t]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,ax,ay,gz,lat,lon", *rows]))
    assert "lat" in sigmaswarm.inspect_log(tmp_path / "log.csv").recipe.to_toml()
    drive = sigmaswarm.import_log(tmp_path / "log.csv", name="made", gps_offset_s=0.5)
    assert drive.name == "made"
    assert drive.frame == "wgs84"
    with pytest.raises(sigmaswarm.InputError, match="'offset'"):
        sigmaswarm.import_log(tmp_path / "log.csv", offset=0.5)
    outside = (
        "log.csv: gps: 600 of 2000 fixes lie outside of .*; there are no fixes during the IMU's first 12 s"
    )
    with pytest.warns(sigmaswarm.SigmaswarmWarning, match=outside):
        sigmaswarm.import_log(tmp_path / "log.csv", gps_offset_s=12.0)
    notes: list[str] = []
    sigmaswarm.import_log(tmp_path / "log.csv", say=notes.append, gps_offset_s=12.0)  # no warnings
    assert any("lie outside" in note for note in notes)


@pytest.mark.parametrize("old", ["LiveSwarm", "run_swarm", "datasheet"])
def test_names_of_0_3_0_still_work_and_name_their_successor(old: str):
    with pytest.warns(DeprecationWarning, match=f"sigmaswarm.{old} is now (.*)") as warned:
        found = getattr(sigmaswarm, old)
    assert found is getattr(sigmaswarm, str(warned[0].message).rsplit(" ", 1)[1])


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'sigmaswarm' has no attribute 'tone'"):
        attrgetter("tone")(sigmaswarm)


def test_importing_the_package_imports_nothing_heavy():
    program = (
        "import sys, sigmaswarm; print(sorted(set(sys.modules) & {'numba', 'numpy', 'polars', 'pydantic'}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("name", "positional", "keyword_only"),
    [
        ("read_drive", ["path"], []),
        ("write_drive", ["drive", "path"], []),
        ("initial_state", ["drive"], []),
        ("run_filter", ["drive", "parameters"], ["initial"]),
        ("run_batch", ["drives", "parameter_sets"], ["objective"]),
        ("evaluate", ["drives", "parameters"], []),
        ("tune", ["drives"], []),
        ("FilterParameters", ["alpha", "beta", "kappa", "process_noise", "measurement_noise", "model"], []),
    ],
)
def test_signatures(name: str, positional: list[str], keyword_only: list[str]):
    parameters = inspect.signature(getattr(sigmaswarm, name)).parameters
    kinds = {p.name: p.kind for p in parameters.values()}
    assert [n for n, kind in kinds.items() if kind is inspect.Parameter.POSITIONAL_OR_KEYWORD] == positional
    assert {n for n, kind in kinds.items() if kind is inspect.Parameter.KEYWORD_ONLY} >= set(keyword_only)


def test_defaults_of_the_signatures():
    signature = inspect.signature
    assert signature(sigmaswarm.run_batch).parameters["objective"].default == "truth-rmse"
    assert signature(sigmaswarm.FilterParameters).parameters["model"].default == "planar5"
    assert signature(sigmaswarm.run_filter).parameters["initial"].default is None


def test_shapes():
    start = sigmaswarm.initial_state(DRIVE)
    assert (start.mean.shape, start.covariance.shape) == ((5,), (5, 5))
    assert isinstance(start.time, float)
    estimate = sigmaswarm.run_filter(DRIVE, SET)
    n = int(np.sum(DRIVE.imu.time > start.time))
    np.testing.assert_array_equal(estimate.time, DRIVE.imu.time[DRIVE.imu.time > start.time])
    assert (estimate.mean.shape, estimate.covariance.shape) == ((n, 5), (n, 5, 5))
    assert np.all((estimate.mean[:, 4] > -np.pi) & (estimate.mean[:, 4] <= np.pi))
    assert estimate.failure is None
    result = sigmaswarm.run_batch([DRIVE, DRIVE], [SET, SET, SET])
    assert (result.costs.shape, result.failed.shape) == ((3,), (3,))
    assert [len(row) for row in result.scores] == [2, 2, 2]
    assert isinstance(result.scores[0][0], sigmaswarm.Score)


def test_a_filter_starts_where_it_is_told():
    later = sigmaswarm.InitialState(np.array([1.0, 2, 3, 4, 0.5]), np.eye(5), 9.0)
    estimate = sigmaswarm.run_filter(DRIVE, SET, initial=later)
    assert estimate.time[0] == DRIVE.imu.time[DRIVE.imu.time > 9.0][0]
    assert estimate.initial is later
    assert np.hypot(*(estimate.mean[0, :2] - [1, 2])) < 1.0


def test_a_failed_filter_says_when_and_leaves_no_numbers_after_it():
    bad = replace(SET, process_noise=(1.0, 1.0, -3.0, 1.0, 1.0))
    estimate = sigmaswarm.run_filter(DRIVE, bad)
    assert estimate.failure.startswith("synthetic: the filter failed at t = ")
    first = int(np.flatnonzero(np.isnan(estimate.mean[:, 0]))[0])
    assert f"t = {estimate.time[first]:.3f} s" in estimate.failure
    assert np.isnan(estimate.mean[first:]).all()
    assert np.isfinite(estimate.mean[:first]).all()
    assert np.linalg.eigvalsh(estimate.covariance[:first]).min(initial=np.inf) > 0


def test_a_filter_fails_without_a_fix_to_tell_it():
    start = sigmaswarm.initial_state(DRIVE)
    blind = replace(DRIVE, gps=DRIVE.gps.select(DRIVE.gps.time <= start.time))
    bad = replace(SET, process_noise=(1.0, 1.0, -3.0, 1.0, 1.0))
    assert sigmaswarm.run_filter(blind, bad, initial=start).failure
    assert sigmaswarm.run_batch([blind], [bad], objective="truth-rmse").failed.all()


def test_truth_never_reaches_a_filter(tmp_path: Path):
    """Estimates are bit-identical with truth.csv deleted."""
    sigmaswarm.write_drive(DRIVE, tmp_path / "drive")
    with_truth = sigmaswarm.read_drive(tmp_path / "drive")
    (tmp_path / "drive" / "truth.csv").unlink()
    without = sigmaswarm.read_drive(tmp_path / "drive")
    assert with_truth.truth is not None
    assert without.truth is None
    for run in (sigmaswarm.run_filter, sigmaswarm.run_textbook):
        a, b = run(with_truth, SET), run(without, SET)
        assert (a.mean.tobytes(), a.covariance.tobytes()) == (b.mean.tobytes(), b.covariance.tobytes())


# --- Options of a tuning --------------------------------------------------------------------------------------------


def test_type_checkers_know_the_options_of_the_model():
    """`TuneConfig` states the options; the TypedDict repeats names and types for type checkers."""
    hints, fields = (
        get_type_hints(TuneOptions),
        TuneConfig.model_fields,
    )
    assert set(hints) == set(fields)
    plain = {name: Sequence[Option] if name == "use" else field.annotation for name, field in fields.items()}
    assert {n: h for n, h in hints.items() if n != "optimizer"} == {
        n: p for n, p in plain.items() if n != "optimizer"
    }
    assert all(field.description for field in fields.values())
    assert set(get_type_hints(CompareOptions)) == set(hints) - {
        "seed",
        "optimizer",
        "scale",
        "prior",
        "inflation",
    }


@pytest.mark.parametrize(("command", "asked"), [(tune, TuneOptions), (compare, CompareOptions)])
def test_the_command_line_has_the_options(command, asked: type):
    parameters = inspect.signature(command).parameters
    names = asked.__annotations__
    assert set(names) <= set(parameters)
    assert all(parameters[name].default is None for name in names)


@pytest.mark.parametrize(
    ("given", "suggested"),
    [
        ("n_trials", "trials"), ("random_state", "seed"), ("max_iter", "generations"), ("n_jobs", "executor"),
        ("n_iterations", "generations"), ("partikles", "particles"), ("valdation", "validation"), ("loss", "objective"),
    ],
)  # fmt: skip
def test_an_unknown_option_suggests_the_right_one(given: str, suggested: str):
    with pytest.raises(
        sigmaswarm.InputError, match=rf"{given} = 3: no such option; did you mean {suggested}\?"
    ):
        sigmaswarm.tune([DRIVE], **{given: 3})


@pytest.mark.long
def test_a_type_checker_knows_the_options(tmp_path: Path):
    pytest.importorskip("pyright", reason="pyright is not installed (dependency group check)")
    (tmp_path / "right.py").write_text(
        "import sigmaswarm\n\n\ndef f(d: sigmaswarm.Drive, p: sigmaswarm.FilterParameters) -> None:\n"
        '    sigmaswarm.tune([d], particles=4, use=["gate"], model="planar8")\n'
        '    sigmaswarm.compare(d, validation=[d], kind="ekf", particles=4)\n'
        "    sigmaswarm.evaluate([d], p)\n"
    )
    (tmp_path / "wrong.py").write_text(
        "import sigmaswarm\n\n\ndef f(d: sigmaswarm.Drive, p: sigmaswarm.FilterParameters) -> None:\n"
        "    sigmaswarm.tune([d], partikles=4)\n"
        '    sigmaswarm.tune([d], particles="many")\n'
        '    sigmaswarm.tune([d], use=["gates"])\n'
        '    sigmaswarm.compare([d], optimizer="pso")\n'
        "    sigmaswarm.evaluate(p, [d])\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    found = [e for e in json.loads(done.stdout)["generalDiagnostics"] if e["severity"] == "error"]
    assert {Path(e["file"]).name for e in found} == {"wrong.py"}
    assert {e["range"]["start"]["line"] for e in found} == {4, 5, 6, 7, 8}


def test_arguments_in_the_old_order_are_told():
    with pytest.raises(sigmaswarm.InputError, match="evaluate takes the drives first"):
        sigmaswarm.evaluate(SET, [DRIVE])
