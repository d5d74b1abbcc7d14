"""Defaults of `tune`: they depend on the logs alone."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.drives.drive import Drive, Odometer
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.sensors import has_white_errors
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.names import FilterKind
from sigmaswarm.filters.parameters import FilterParameters, incompatibility
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.config import paper_options
from sigmaswarm.tuning.defaults import default_filter_options, objective_for
from sigmaswarm.tuning.diagnostics import scale_warnings
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.space import OPTIONS
from sigmaswarm.tuning.tune import tune
from support import DRIVES, diagonal, make_drive, needs_shared

WHOLE = make_drive(duration=25.0)
PLAIN = replace(WHOLE, imu=replace(WHOLE.imu, az=None, gx=None, gy=None))
N, FIXES = len(PLAIN.imu), len(PLAIN.gps)
SMALL = {"particles": 4, "generations": 2}
CAR = ("lateral", "standstill", "robust")


def six(drive: Drive, up: float = 9.8, turning: float = 0.01) -> Drive:
    """Add the other three axes: ``up`` on az, and gx and gy that oscillate by ``turning``."""
    swing = turning * np.sin(np.arange(len(drive.imu)))
    return replace(drive, imu=replace(drive.imu, az=np.full(len(drive.imu), up), gx=swing, gy=-swing))


def stating(drive: Drive, low: float, high: float) -> Drive:
    std = np.linspace(low, high, len(drive.gps))
    return replace(drive, gps=replace(drive.gps, std_x=std, std_y=std))


def wheeled(drive: Drive) -> Drive:
    return replace(drive, odometer=Odometer(drive.imu.time, np.full(len(drive.imu), 5.0)))


def chosen(*drives: Drive) -> tuple[str, tuple[str, ...]]:
    found = suggest_filter(drives)
    return found.model, found.use


def test_the_default_filter_depends_on_the_columns_of_the_log():
    assert chosen(PLAIN) == ("planar8", CAR)
    assert chosen(six(PLAIN)) == ("tilted12", CAR)
    assert chosen(wheeled(PLAIN)) == ("planar8", ("lateral", "standstill", "odometer", "robust"))
    assert chosen(stating(PLAIN, 1.0, 9.0)) == ("planar8", ("lateral", "standstill", "accuracy", "robust"))
    assert chosen(stating(PLAIN, 2.0, 2.0)) == ("planar8", CAR)  # all fixes have the same accuracy
    speed = np.full(FIXES, 5.0)
    assert chosen(replace(PLAIN, gps=replace(PLAIN.gps, speed=speed, course=0 * speed))) == ("planar8", CAR)


def test_the_use_list_that_adds_the_heading_contains_the_others():
    headed = replace(PLAIN, gps=replace(PLAIN.gps, heading=np.zeros(FIXES)))
    options, said = default_filter_options({}, [headed])
    assert said.endswith(f". To use the heading, write --use {' '.join(options['use'])} heading")
    assert "heading" not in default_filter_options({}, [headed, PLAIN])[1]


@pytest.mark.parametrize(
    ("up", "turning"), [(0.0, 0.01), (1.0, 0.01), (-9.8, 0.01), (9.8, 0.0)], ids=["none", "g", "down", "dead"]
)
def test_six_columns_with_wrong_values_are_not_used(up: float, turning: float):
    assert chosen(six(PLAIN, up, turning))[0] == "planar8"
    assert (
        suggest_filter([six(PLAIN, up, turning)]).because
        == "az does not show gravity, or gx or gy is constant"
    )


def test_the_default_uses_only_the_columns_that_all_drives_have():
    rich = stating(wheeled(six(PLAIN)), 1.0, 9.0)
    assert chosen(rich, rich) == ("tilted12", ("lateral", "standstill", "odometer", "accuracy", "robust"))
    assert chosen(rich, PLAIN) == chosen(PLAIN, rich) == ("planar8", CAR)
    assert chosen(rich, six(PLAIN)) == ("tilted12", CAR)
    one, other = stating(PLAIN, 1.0, 1.0), stating(PLAIN, 3.0, 3.0)
    assert chosen(one, other) == ("planar8", CAR)  # within each log, all fixes have the same accuracy


def test_truth_and_errors_do_not_change_the_default_filter():
    noisy = replace(PLAIN, truth=None, gps=replace(PLAIN.gps, x=PLAIN.gps.x + 30.0 * np.arange(FIXES)))
    assert suggest_filter([noisy]) == suggest_filter([PLAIN])


def noisy(drive: Drive, std: float, name: str = "noisy", stated: float | None = None) -> Drive:
    """Return a drive without truth whose fixes have white errors; ``stated`` is the accuracy in drive.toml."""
    t, truth = drive.gps.time, drive.truth
    noise = np.random.default_rng(0).normal(0.0, std, (2, len(t)))
    x, y = (np.interp(t, truth.time, of) + off for of, off in zip((truth.x, truth.y), noise, strict=True))
    metadata = drive.metadata if stated is None else {**drive.metadata, "gps_std_m": stated}
    gps = replace(drive.gps, x=x, y=y)
    return replace(drive, name=name, gps=gps, truth=None, metadata=metadata)


def test_the_objective_adds_forecasts_for_white_errors_and_the_likelihood_for_correlated_ones():
    long = make_drive(duration=60.0)
    auto = partial(objective_for, objective="auto", model="tilted12")
    forecasts = "0.5 innovation-t + 0.5 forecast-t"
    white, copying = noisy(long, 1.0), noisy(long, 0.05, "copying")
    assert auto([white]) == forecasts
    assert objective_for([white], "auto", "tilted12", ("lateral", "fix-error")) == forecasts
    assert auto([copying]) == "innovation-t"
    assert auto([noisy(long, 1.0, stated=5.0)]) == "innovation-t"  # most of the 5 m must be correlated
    assert auto([noisy(long, 0.3, stated=0.3)]) == forecasts
    assert auto([noisy(long, 0.01, stated=0.01)]) == "innovation-t"  # can't be distinguished from motion
    assert auto([white, copying]) == "innovation-t"
    assert auto([white, copying, noisy(long, 1.0, "other")]) == forecasts  # most of the drives
    assert auto([white, noisy(WHOLE, 1.0, "short")]) == "innovation-t"  # too short for hidden fixes
    for asked in ("innovation-t", "outage-rmse"):
        assert objective_for([white], asked, "tilted12") == asked
    known, exact = (replace(one, truth=long.truth) for one in (white, copying))
    correlated = replace(exact, gps=replace(exact.gps, x=exact.gps.x + 1.5, y=exact.gps.y - 1.0))
    assert auto([known]) == "truth-pose + 0.2 nees + 0.2 forecast-t"
    assert (
        auto([known], model="planar8")
        == auto([known, correlated], model="planar8")
        == auto([replace(noisy(long, 0.01, stated=0.01), truth=long.truth)])
        == auto([exact])  # the truth shows that these errors are white
        == "truth-pose + 0.2 nees"
    )
    assert (
        auto([correlated])
        == auto([correlated, known, correlated], model="planar8")
        == "truth-pose + 0.2 nees + 0.1 innovation-t"
    )
    assert (
        objective_for([known], "auto", "tilted12", ("fix-error",))
        == "innovation-t + 0.2 truth-pose + 0.2 nees"
    )
    assert auto([white], model="planar8") == "innovation-t"  # it would adapt to these roads only
    assert tune(six(white), **SMALL).config.model_dump()["objective"] == forecasts


@pytest.mark.parametrize(
    ("gps", "white", "stated"),
    diagonal(
        [("white-1m", True), ("gnss-ins-sim", True), ("ublox-m8", False), ("f9p-rtk", False)], [True, False]
    ),
)
def test_correlated_fix_errors_are_distinguished_from_white_ones(gps: str, white: bool, stated: bool):
    drive = simulate("urban", duration=100.0, gps=gps, seed=3)
    if not stated:
        drive = replace(drive, gps=replace(drive.gps, std_x=None, std_y=None), metadata={})
    assert has_white_errors(drive) == white


@needs_shared
@pytest.mark.parametrize(
    ("name", "white"),
    [("colorado-1", True), ("kitti-09-30-0018", True), ("kingston-1", False), ("comma2k19", False)],
)
@pytest.mark.filterwarnings("ignore::sigmaswarm.SigmaswarmWarning")
def test_correlated_fix_errors_of_real_receivers(name: str, white: bool):
    assert has_white_errors(read_drive(DRIVES / name)) == white


def smoothing(stated: float, up: float = 3.0, name: str = "smoothing") -> Drive:
    """Return a drive without truth with the fixes of `noisy` (0.05 m) and a larger, varying stated accuracy."""
    return stating(noisy(make_drive(duration=60.0), 0.05, name), stated, up * stated)


def test_the_default_adds_fix_error_if_the_scatter_is_less_than_stated():
    lasting, used = smoothing(2.0), ("lateral", "standstill", "accuracy", "robust")
    truth = make_drive(duration=60.0).truth

    def chosen_for(drives: list[Drive], **options: str) -> tuple[str, ...]:
        return default_filter_options(options, drives)[0]["use"]

    assert chosen_for([lasting]) == (*used, "fix-error")
    assert default_filter_options({}, [lasting])[1].endswith("so the fix errors are probably correlated")
    assert chosen_for([lasting, replace(lasting, truth=truth)]) == (*used, "fix-error")
    assert chosen_for([replace(lasting, truth=truth)]) == used
    assert chosen_for([replace(lasting, truth=truth)], objective="innovation-t") == (*used, "fix-error")
    assert chosen_for([stating(noisy(make_drive(duration=60.0), 1.0), 0.8, 2.0)]) == used  # visible
    assert chosen_for([smoothing(0.02)]) == used  # less than the motion between fixes
    short = clip(lasting, 0.0, 40.0)  # 200 fixes
    assert chosen_for([short]) == used
    assert chosen_for([short, short]) == (*used, "fix-error")
    assert chosen_for([lasting, stating(noisy(make_drive(duration=60.0), 1.0), 0.8, 2.0)]) == used
    assert chosen_for([smoothing(2.0, 1.1)]) == (*CAR, "fix-error")
    assert chosen_for([noisy(make_drive(duration=60.0), 0.05)]) == (*CAR, "fix-error")  # assumes 2.1 m
    assert chosen_for([noisy(make_drive(duration=60.0), 0.05, stated=0.05)]) == CAR
    assert chosen_for([noisy(make_drive(duration=60.0), 1.0)]) == CAR
    white = noisy(make_drive(duration=60.0), 1.0)
    held = {name: np.repeat(getattr(white.gps, name), 5) for name in ("x", "y")}
    times = np.ravel(white.gps.time[:, None] + np.linspace(0.0, 0.16, 5))
    assert (
        chosen_for([replace(white, gps=replace(white.gps, time=times, **held))]) == CAR
    )  # each fix five times
    assert chosen_for([six(lasting)], model="planar8") == used
    assert chosen_for([lasting], model="planar5") == ()
    for kind in ("fuzzy-ukf", "strong-tracking-ukf"):
        assert "fix-error" not in chosen_for([lasting], kind=kind)
    assert chosen_for([six(lasting)], kind="ukf", model="tilted12") == used
    assert chosen_for([six(lasting)]) == (*used, "fix-error")
    assert truth is not None
    known = six(replace(lasting, truth=replace(truth, x=truth.x + 2.0)))
    assert chosen_for([known]) == (*used, "fix-error"), "with truth, only for tilted12"
    assert chosen_for([six(replace(lasting, truth=truth))]) == used, "the fixes are accurate"
    assert chosen_for([known], objective="truth-pose + 0.2 nees") == used, (
        "the objective does not determine the parameters of fix-error"
    )


def test_options_of_the_user_are_kept():
    both = {"model": "planar5", "use": ("gate",)}
    assert default_filter_options(both, [six(PLAIN)]) == (both, "")
    given, said = default_filter_options({"use": ("gate",)}, [six(PLAIN)])
    assert (given, said) == (
        {"use": ("gate",), "model": "tilted12"},
        "tilted12 with gate (as given), since the IMU has six axes",
    )
    given, said = default_filter_options({"model": "planar8"}, [six(PLAIN)])
    assert given == {"model": "planar8", "use": CAR}
    assert said == (
        "planar8 with lateral, standstill, robust, as given. tilted12 suits the logs, since the IMU has six axes"
    )
    assert default_filter_options({"model": "planar8", "use": ()}, [PLAIN])[0]["use"] == ()
    given, said = default_filter_options({"model": "planar5"}, [PLAIN])  # the paper's model
    assert given["use"] == ()
    assert said.startswith("planar5 with position fixes alone, as given. This is the paper's model;")
    assert default_filter_options(paper_options({}), [six(PLAIN)]) == (paper_options({}), "")


@given(
    kind=st.none() | st.sampled_from(("ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf")),
    objective=st.sampled_from(("auto", "innovation-nll + 0.1 nis", "truth-pose")),
    axes=st.booleans(),
    states=st.booleans(),
)
def test_the_default_options_are_compatible_with_the_given_ones(
    kind: FilterKind | None, objective: str, axes: bool, states: bool
):
    drive = stating(PLAIN, 1.0, 9.0) if states else PLAIN
    asked = {"objective": objective} | ({} if kind is None else {"kind": kind})
    found, _ = default_filter_options(asked, [six(drive) if axes else drive])
    kinds = MODELS[found["model"]].filter_types
    assert kind is None or kind in kinds
    assert incompatibility(kind or kinds[0], found["use"]) is None
    assert not ("robust" in found["use"] and "innovation-nll" in objective)
    assert set(found["use"]) <= set(OPTIONS)
    assert {"lateral", "standstill"} <= set(found["use"])


def test_tune_applies_the_defaults_and_its_result_contains_them():
    tuning = tune(PLAIN, **SMALL)
    config = tuning.config.model_dump()
    assert (config["model"], config["use"], config["objective"]) == ("planar8", CAR, "truth-pose + 0.2 nees")
    again = tune(PLAIN, model="planar8", use=CAR, objective="truth-pose + 0.2 nees", **SMALL)
    assert again.to_dict() == tuning.to_dict()
    blind = replace(PLAIN, truth=None)
    assert objective_for([blind], "auto") == "innovation-t"
    held_back = replace(stating(six(blind), 1.0, 9.0), name="rich")
    with pytest.raises(InputError, match="gate"):  # options of the user are checked, the others chosen
        tune(six(blind), validation=held_back, use=["gate", "robust"], **SMALL)


@needs_shared
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("kitti-09-30-0033", "--model tilted12 --use lateral standstill robust"),
        ("comma2k19", "--model planar8 --use lateral standstill odometer robust"),
        ("kingston-1", "--model planar8 --use lateral standstill accuracy robust"),
    ],
)
@pytest.mark.filterwarnings("ignore::sigmaswarm.SigmaswarmWarning")
def test_real_logs(name: str, options: str):
    from sigmaswarm import read_drive

    assert suggest_filter([read_drive(DRIVES / name)]).options == options


# --- The scale of the covariances ---------------------------------------------------------------------------------

CAREFUL = FilterParameters(
    0.5, 2.0, 0.0, (1e-6,) * 2 + (1e-4,) * 2 + (1e-8,) + (1e-8,) * 2 + (1e-11,), (1.0, 1.0), "planar8",
    kind="ekf", lateral_noise=0.1, standstill_noise=1e-3, accuracy_scale=0.5,
)  # fmt: skip


def test_scaled_multiplies_every_variance():
    four = CAREFUL.scaled(4.0)
    assert four.process_noise == tuple(4 * q for q in CAREFUL.process_noise)
    assert (four.measurement_noise, four.lateral_noise) == ((4.0, 4.0), 0.4)
    assert (four.standstill_noise, four.accuracy_scale) == (4e-3, 2.0)
    assert four.bias_std == tuple(2 * std for std in CAREFUL.bias_std)
    assert (four.velocity_noise, four.odometer_noise, four.alpha) == (None, None, CAREFUL.alpha)
    assert four.scaled(0.25) == CAREFUL
    for factor in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match="is not positive"):
            CAREFUL.scaled(factor)


def test_the_recommended_factor_corrects_nis_and_keeps_the_position():
    drive = stating(PLAIN, 1.0, 1.0)
    replayer = BatchScorer.prepare([drive])
    before = replayer.scores([CAREFUL.scaled(2.0)])
    (said,) = scale_warnings(parse_objective("truth-pose"), CAREFUL.scaled(2.0), replayer)
    assert "truth-pose does not depend on the scale of the covariances (the mean NIS is" in said
    factor = float(said.split("multiplied by ")[1].split(",")[0])
    after = replayer.scores([CAREFUL.scaled(2.0).scaled(factor)])
    assert after.mean_nis[0, 0] == pytest.approx(2.0, rel=0.2)
    assert abs(before.mean_nis[0, 0] - 2.0) > 0.4  # otherwise, the test is not sensitive
    assert after.position_rmse[0, 0] == pytest.approx(before.position_rmse[0, 0], rel=0.02)
    assert said.startswith("TO DO: tune with 'truth-pose + 0.2 nees', or use FilterParameters.scaled(")


def test_no_factor_is_recommended_for_planar5_or_if_the_objective_determines_the_scale():
    replayer = BatchScorer.prepare([PLAIN])
    five = FilterParameters(1.0, 2.0, 0.0, (1e-5, 1e-5, 1e-3, 1e-3, 1e-8), (1.2, 1.2))
    before = replayer.scores([five])
    after = replayer.scores([five.scaled(before.mean_nis[0, 0] / 2)])
    assert after.position_rmse[0, 0] == pytest.approx(before.position_rmse[0, 0], rel=0.02)  # unchanged
    assert after.mean_nis[0, 0] == pytest.approx(2.0, rel=0.2)
    (said,) = scale_warnings(parse_objective("truth-rmse"), five, replayer)
    assert "does not depend on the scale" in said
    assert "on all variances changes" not in said
    for objective, measure in {"2 truth-rmse": "nees", "outage-rmse": "nis"}.items():
        (said,) = scale_warnings(parse_objective(objective), five, replayer)
        assert said.startswith(f"TO DO: tune with '{objective} + 0.2 {measure}'")
    for objective in ("truth-pose + 0.2 nees", "innovation-t", "gps-rmse"):
        assert scale_warnings(parse_objective(objective), five, replayer) == []


@pytest.mark.parametrize("noise", [0.03, 0.1, 0.2])
def test_truth_shows_that_a_receiver_without_stated_accuracy_is_accurate(noise: float):
    """Without truth, such a log can't be distinguished from one with correlated errors of 2 m."""
    drive = simulate("urban", duration=60.0, gps="white-1m", imu_rate=50.0, seed=2)
    assert drive.truth is not None
    rng = np.random.default_rng(0)
    at = [np.interp(drive.gps.time, drive.truth.time, getattr(drive.truth, axis)) for axis in ("x", "y")]
    x, y = (places + rng.normal(0.0, noise, len(places)) for places in at)
    metadata = {name: value for name, value in drive.metadata.items() if name != "gps_std_m"}
    accurate = replace(drive, gps=replace(drive.gps, x=x, y=y, std_x=None, std_y=None), metadata=metadata)
    assert "fix-error" not in default_filter_options({}, [accurate])[0]["use"]
    assert "fix-error" in default_filter_options({}, [replace(accurate, truth=None)])[0]["use"]
    smooth = replace(accurate, gps=replace(accurate.gps, x=x + 2.0, y=y - 1.5))
    assert "fix-error" in default_filter_options({}, [smooth])[0]["use"]
