"""The estimated position error of a filter without truth, compared with its predictions of the fixes."""

from dataclasses import replace

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.filters.run import run_filter
from sigmaswarm.scoring.consistency import Consistency
from sigmaswarm.scoring.evaluation import evaluate
from sigmaswarm.scoring.remarks import describe_first_track, describe_position, estimate_position_errors
from sigmaswarm.scoring.tracks import first_track
from sigmaswarm.tuning.tune import tune


def recorded(nis: float, next_one: float) -> Consistency:
    """Return the record of a filter with a position sigma of 0.5 m and expected innovations of 1.5 m, for 500 fixes."""
    return Consistency(
        n_fixes=500,
        mean_nis=nis,
        nis_band_95=(1.83, 2.18),
        share_inside_95_gate=0.95,
        autocorrelation=[next_one],
        white_p=0.5,
        missed_m=1.5 * (nis / 2) ** 0.5,
        expected_m=1.5,
        own_sigma_m=0.5,
    )


@pytest.mark.parametrize(
    ("nis", "next_one", "said"),
    [
        (2.0, 0.0, "about 0.5 m RMS, estimated by the filter, since there is no truth. The estimate does not account"),
        (2.0, 0.4, "0.5 m RMS or more, estimated by the filter"),
        (3.0, 0.0, "more than the 0.5 m RMS that the filter estimates. The fixes, with their own errors,"),
        (1.7, 0.0, "about 0.5 m RMS, estimated by the filter"),
        (1.7, 0.4, "unknown, since there is no truth. The position error may be as large as the difference between"),
        (0.2, 0.0, "unknown, since there is no truth. The position error may be as large as the difference between"),
    ],
)  # fmt: skip
def test_the_stated_position_error_without_truth_is_checked_with_the_fixes(
    nis: float, next_one: float, said: str
):
    assert describe_position(recorded(nis, next_one)).startswith(said)


@pytest.mark.parametrize("nis", [1.7, 2.0])
def test_correlated_fix_errors_lead_to_a_range(nis: float):
    """A filter with a sigma of 0.35 m had an error of 1.26 m: predictions do not show errors common to all fixes."""
    said = describe_position(recorded(nis, 0.0), 1.4)
    assert said.startswith(
        "between 0.5 and 2 m RMS, estimated without truth. The upper value includes errors that successive fixes share"
    )
    assert describe_position(recorded(nis, 0.0), 0.2).startswith("about 0.5 m RMS")
    unknown = describe_position(recorded(0.2, 0.4), 2.1)  # the covariance includes no error of 2.1 m per axis
    assert (
        "If successive fixes share errors of 2.1 m per axis, the position error is about 3 m RMS" in unknown
    )
    assert "errors that all fixes share" in describe_position(recorded(nis, 0.0))


def test_a_log_that_does_not_show_the_error_gives_no_value():
    """The filter's sigma exceeds the expected innovations, so their difference is not an error."""
    said = describe_position(recorded(0.2, 0.4).model_copy(update={"own_sigma": 1.6}))
    assert said.startswith(
        "unknown, since there is no truth. The filter's covariance corresponds to 1.6 m RMS, but this "
        "value is not reliable"
    )


@pytest.mark.long
def test_the_stated_position_error_is_near_the_true_error_if_the_log_confirms_it():
    """For white fix errors and a consistent filter, the estimate is within a third of the true error."""
    drives = [
        sigmaswarm.simulate("urban", run=run, gps="white-1m", duration=60, imu_rate=50) for run in range(3)
    ]
    tuning = tune([replace(d, truth=None) for d in drives[:2]], particles=12, generations=6, seed=2)
    off = evaluate(drives[2], tuning.parameters).value(drives[2].name, "tuned", "position_rmse_m")
    blind = evaluate(replace(drives[2], truth=None), tuning.parameters)
    own = blind.record.consistency[drives[2].name].own_sigma
    estimate = run_filter(drives[2], tuning.parameters)
    assert own == pytest.approx(
        np.sqrt(np.mean(estimate.covariance[:, [0, 1], [0, 1]].sum(axis=1))), rel=1e-9
    )
    assert own == pytest.approx(off, rel=0.34)
    (said,) = estimate_position_errors(blind.record, blind.setup.data)
    assert f"{own:.2g} m RMS" in said
    track = first_track(drives[2], tuning.parameters, as_recorded=False)
    assert describe_first_track(track).startswith(
        f"Position error on {drives[2].name}: {off:.2g} m RMSE (baseline "
    )
