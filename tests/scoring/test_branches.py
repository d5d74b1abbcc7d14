"""Branches of a pass, compared with one pass per window in which only the fixes of this window are hidden."""

from dataclasses import replace

import numpy as np
import pytest

from filter_cases import OPTIONS, equipped, parameters, rough, two_receivers
from scoring.variants import VARIANTS
from sigmaswarm.drives.drive import Drive, Odometer
from sigmaswarm.drives.events import HIDDEN
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.compiled import run
from sigmaswarm.filters.compiled.layout import LANES, N_KEPT, N_ROWS, R
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, run_passes
from sigmaswarm.scoring import targets
from sigmaswarm.scoring.batch import NAMES, BatchScorer, PassOptions

FILTERS = {
    "planar5": parameters("planar5"),
    "adaptive": parameters("planar5", kind="adaptive-ukf", forgetting=0.9),
    "planar8": parameters("planar8", kind="ekf", odometer_noise=0.1, **OPTIONS["all"]),
    "robust": parameters("planar8", kind="ekf", robust_dof=4.0),
    "fix-error": parameters("planar8", kind="ekf", fix_error=0.9, fix_std=1.0),
    "tilted12": parameters("tilted12", lateral_noise=0.05),
}
BRANCH_SUMS = ("SQ_POSITION", "SQ_FORECAST", "FORECAST_T")


def long_drive() -> Drive:
    """Return a minute with a stop, an odometer, and few fixes at the end, where a window contains none."""
    drive = equipped(60.0)
    speed = np.interp(drive.imu.time, drive.truth.time, np.hypot(drive.truth.vx, drive.truth.vy))
    wheels = Odometer(drive.imu.time[3::10], speed[3::10])
    late = (drive.gps.time > 45.0) & (drive.gps.time < 59.0)
    return replace(drive, odometer=wheels, gps=drive.gps.select(~late))


DRIVES = {
    "long": long_drive,
    "two receivers": two_receivers,
    "rough": rough,
    "slow truth": lambda: VARIANTS["1-hz"],
}
CASES = [("long", name) for name in FILTERS]
CASES += [(drive, "planar5") for drive in DRIVES if drive != "long"]


def passes_of(drive: Drive, *, seed: int = 0) -> tuple[FilterPass, FilterPass, FilterPass]:
    ready = PreparedDrive(drive)
    return (
        targets.tracking_pass(ready),
        targets.outage_pass(ready, seed=seed),
        targets.forecast_pass(ready, seed=seed),
    )


def sums_by_window(monkeypatch: pytest.MonkeyPatch, drive: Drive, p: FilterParameters) -> np.ndarray:
    """Return the sums of branches from separate passes over the whole drive."""
    _, outages, forecasts = passes_of(drive)
    total = np.zeros(3)
    for name, whole, number in (("outage_windows", outages, 1), ("forecast_windows", forecasts, 2)):
        for window in whole.windows:
            with monkeypatch.context() as patch:
                patch.setattr(targets, name, lambda *_, window=window, **__: window[np.newaxis])
                one = passes_of(drive)[number]
            sums = run_passes([one], [p])
            total += np.array([sums[sum_][0, 0] for sum_ in BRANCH_SUMS]) * (
                number == 1,
                number == 2,
                number == 2,
            )
    return total


@pytest.mark.parametrize(("name", "p"), CASES)
def test_each_window_begins_with_a_filter_that_used_all_earlier_fixes(
    name: str, p: str, monkeypatch: pytest.MonkeyPatch
):
    drive, filter_ = DRIVES[name](), FILTERS[p]
    tracking, outages, forecasts = passes_of(drive)
    assert len(outages.windows) + len(forecasts.windows) >= (6 if name == "long" else 2)
    branched = run_passes([replace(tracking, branches=(outages, forecasts))], [filter_])
    expected = sums_by_window(monkeypatch, drive, filter_)
    of_branches = branched.of_branches
    np.testing.assert_allclose([of_branches[sum_][0, 0] for sum_ in BRANCH_SUMS], expected, rtol=1e-12)
    assert expected.min() > 0.0
    assert not branched.failed.any()


@pytest.mark.parametrize(("name", "p"), CASES)
def test_branches_change_no_bit_of_the_other_scores(name: str, p: str):
    drive = DRIVES[name]()
    options = PassOptions(outages=True, forecasts=True, outage_seed=2)
    plain, branched = (
        BatchScorer.prepare([drive], replace(options, branched=on)).scores([FILTERS[p]])
        for on in (False, True)
    )
    others = {"outage_drift", "forecast_rmse", "forecast_t"}
    for score in set(NAMES) - others - {"failed"}:
        np.testing.assert_array_equal(getattr(branched, score), getattr(plain, score), err_msg=score)
    for score in others:
        assert 0.5 < getattr(branched, score)[0, 0] / getattr(plain, score)[0, 0] < 2.0


@pytest.mark.parametrize("seed", [0, 4])
def test_windows_in_one_gap_of_the_imu_are_scored_once(seed: int):
    drive = equipped(120.0)
    gap = (drive.imu.time > 50.0) & (drive.imu.time < 65.0)
    columns = {name: values[~gap] for name, values in vars(drive.imu).items() if values is not None}
    tracking, outages, forecasts = passes_of(replace(drive, imu=replace(drive.imu, **columns)), seed=seed)
    flags = replace(tracking, branches=(outages, forecasts)).arrays(frozenset())[3]
    assert np.sum((flags & HIDDEN) != 0) == forecasts.n_hidden + outages.n_hidden


def test_a_pass_with_branches_has_fewer_steps_than_three_passes():
    options = PassOptions(outages=True, forecasts=True)
    plain, branched = (
        BatchScorer.prepare([long_drive()], replace(options, branched=on)).steps[0] for on in (False, True)
    )
    assert branched < 0.65 * plain


def test_drives_may_be_scored_together_or_alone():
    options = PassOptions(outages=True, forecasts=True, branched=True)
    drives = [long_drive(), rough(), two_receivers()]
    sets = [FILTERS["planar5"], FILTERS["robust"]]
    whole = BatchScorer.prepare(drives, options).scores(sets)
    parts = [BatchScorer.prepare([drive], options) for drive in drives]
    np.testing.assert_array_equal(BatchScorer.joined(parts).scores(sets).numbers, whole.numbers)
    some = BatchScorer.joined(parts).subset([2, 0]).scores(sets)
    np.testing.assert_array_equal(some.numbers, whole.numbers[..., [2, 0]])


def test_a_failure_in_a_branch_is_a_failure_of_the_filter():
    w, kept = np.ones((N_ROWS, LANES)), np.ones((N_KEPT, LANES))
    run._keep_copy(w, kept)
    w[R.OK, 3], w[R.X], w[R.SQ_POSITION], w[R.NIS] = 0.0, 7.0, 2.0, 9.0
    run._return(w, kept)
    assert w[R.OK].tolist() == [1.0, 1.0, 1.0, 0.0, *[1.0] * (LANES - 4)]
    assert (w[R.X] == 1.0).all()
    assert (w[R.NIS] == 1.0).all()
    assert (w[[R.SQ_POSITION, R.SQ_BRANCH]] == [[1.0], [3.0]]).all()
