"""The priors: their values, the objectives that use them, and their purpose.

The prior on R is for receivers that smooth their fixes, that on the other parameters for logs that do not determine
them.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm import Drive, run_batch, simulate, tune
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, log_properties, receiver_std, stated_std
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.defaults import FIX_ERROR_OBJECTIVE, complete_config, with_default_guards
from sigmaswarm.tuning.problem import car_problem
from sigmaswarm.tuning.receiver import prior_costs
from sigmaswarm.tuning.space import search_space

SEARCH = {"particles": 12, "generations": 8, "model": "planar8", "kind": "ekf"}


@cache
def town() -> Drive:
    return simulate("urban", duration=60.0, gps="white-1m", imu_rate=50.0)


def without_statement(drive: Drive) -> Drive:
    about = {k: v for k, v in drive.metadata.items() if k != "gps_std_m"}
    return replace(drive, gps=replace(drive.gps, std_x=None, std_y=None), metadata=about)


def smoothed(drive: Drive) -> Drive:
    """Return fixes of a smoothing receiver: 2 cm of noise between fixes, slowly varying errors of 1.5 m."""
    truth, gps, rng = drive.truth, drive.gps, np.random.default_rng(7)
    assert truth is not None
    x, y = (np.interp(gps.time, truth.time, v) for v in (truth.x, truth.y))
    slow = [1.5 * np.sin(2 * np.pi * gps.time / 60.0 + phase) for phase in (0.3, 1.4)]
    white = rng.normal(0.0, 0.02, (2, len(gps)))
    return without_statement(
        replace(drive, gps=replace(gps, x=x + slow[0] + white[0], y=y + slow[1] + white[1]))
    )


def seldom(drive: Drive) -> Drive:
    """Return accurate fixes every four seconds."""
    truth, silent = drive.truth, without_statement(drive)
    assert truth is not None
    gps = silent.gps.select(np.arange(len(silent.gps)) % 20 == 0)
    x, y = (np.interp(gps.time, truth.time, v) for v in (truth.x, truth.y))
    return replace(silent, gps=replace(gps, x=x, y=y))


def parameters(r: tuple[float, float], scale: float | None = None) -> FilterParameters:
    return FilterParameters(0.1, 2.0, 0.0, (1e-3,) * 5, r, accuracy_scale=scale)


@given(
    r=st.tuples(st.floats(1e-4, 1e3), st.floats(1e-4, 1e3)),
    std=st.floats(0.01, 30.0),
    scale=st.none() | st.floats(1e-3, 10.0),
)
def test_the_prior_is_a_half_log_normal_with_half_a_decade_below_the_stated_variance(r, std, scale):
    drive = replace(without_statement(town()), metadata={"gps_std_m": std})
    by_hand = 0.0
    for each in r:
        variance = each + (scale or 0.0) * std**2
        if variance < std**2:
            by_hand += 0.5 * (np.log10(variance / std**2) / 0.5) ** 2 / 2
    assert prior_costs([parameters(r, scale)], np.array([stated_std(drive)]))[0, 0] == pytest.approx(
        by_hand, rel=1e-9, abs=1e-12
    )


def test_the_stated_accuracy_has_priority():
    silent = without_statement(town())
    assert receiver_std(silent) == pytest.approx((1.0, 1.0), rel=0.1)  # estimated from the fixes
    assert stated_std(silent) is None
    assert receiver_std(smoothed(town())) == (UNSTATED_GPS_STD, UNSTATED_GPS_STD)
    assert receiver_std(seldom(town())) == (
        UNSTATED_GPS_STD,
        UNSTATED_GPS_STD,
    )  # the differences are due to motion
    told = replace(silent, metadata={"gps_std_m": 0.3})
    assert receiver_std(told) == stated_std(told) == (0.3, 0.3)
    n = len(silent.gps)
    each = replace(told.gps, std_x=np.full(n, 0.5), std_y=np.linspace(1.0, 3.0, n))
    assert receiver_std(replace(told, gps=each)) == pytest.approx((0.5, 2.0))


def test_with_the_prior_a_filter_does_not_copy_a_receiver_that_smooths():
    drive = smoothed(town())
    copied, held = (
        tune(drive, objective="innovation-nll", prior=prior, inflation=0.0, **SEARCH) for prior in (0.0, 1.0)
    )
    assert max(copied.parameters.measurement_noise) < 0.1**2
    assert min(held.parameters.measurement_noise) > 0.5**2
    std = max(held.parameters.measurement_noise) ** 0.5
    said = f"{std:.2g} m per axis, a compromise between the innovations and this value"
    assert [r for r in held.remarks if said in r and "`tune` assumed 2.1 m per axis, as for a typical" in r]
    assert not [r for r in copied.remarks if "a compromise" in r]
    other = simulate("urban", duration=60.0, gps="white-1m", seed=3, imu_rate=50.0)
    follows, knows = run_batch([other], [copied.parameters, held.parameters]).costs
    assert knows < 0.8 * follows


def test_the_prior_is_added_to_the_cost():
    tuning = tune(town(), objective="innovation-t", inflation=0.0, **SEARCH)
    plain = run_batch([town()], [tuning.parameters], objective="innovation-t").costs[0]
    assert tuning.config.prior == 1.0
    assert (
        "; a prior with weight 1 penalizes an R below the receiver's variance"
        in tuning.to_dict()["result"]["objective_meaning"]
    )
    assert tuning.cost == plain + prior_costs([tuning.parameters], np.array([receiver_std(town())]))[0, 0]


TYPICAL = {  # per second, at 50 Hz; width in decades
    **{"q_xy": (1e-7 / 50, 3), "q_vxy": (1e-4 / 50, 2), "q_theta": (1e-8 / 50, 2), "q_tilt": (1e-8 / 50, 2)},
    **{"q_accel_bias": (1e-8 / 50, 2), "q_gyro_bias_xy": (1e-11 / 50, 2), "q_gyro_bias_z": (1e-11 / 50, 2)},
    **{"accel_bias_std": (0.05, 1), "gyro_bias_std": (5e-4, 1), "robust_dof": (4.0, 0.5)},
    **{"lateral_noise": (0.2**2, 2), "standstill_noise": (0.05**2, 2)},
}


@pytest.mark.parametrize(("duration", "weight"), [(60.0, 1 / 250), (150.0, 1 / 250), (300.0, 1 / 500)])
def test_the_prior_agrees_with_its_definition(duration: float, weight: float):
    use = ("lateral", "standstill", "robust")
    config = TuneConfig(model="tilted12", use=use, objective="innovation-t", prior=1.0)
    problem = replace(car_problem([town()], config), data=[{"duration_s": duration / 2}] * 2)
    space = problem.space
    assert {*space.names} == {*TYPICAL, "rear_axle", "r_xy"}
    points = np.random.default_rng(3).uniform(
        0.4 * space.low + 0.6 * space.high, space.high, (4, len(space.names))
    )
    by_hand = np.zeros(len(points))
    for name, values in zip(space.names, space.values(points).T, strict=True):
        if name in TYPICAL:
            by_hand += 0.5 * (np.log10(values / TYPICAL[name][0]) / TYPICAL[name][1]) ** 2
        elif name == "rear_axle":
            by_hand += 0.5 * (values - 1.3) ** 2
    priors = weight * by_hand + prior_costs(space.decode(points), np.array([receiver_std(town())]))[:, 0]
    added = problem.costs(points, None) - problem.costs_without_prior(points, None)
    np.testing.assert_allclose(added, priors, rtol=1e-9, atol=1e-9)


def test_a_parameter_that_a_log_does_not_determine_stays_near_its_typical_value():
    drive = town()
    free, near = (
        tune(drive, objective="innovation-t", prior=prior, inflation=0.0, model="tilted12", generations=25)
        for prior in (0.0, 1.0)
    )
    problem = car_problem([drive], near.config)
    distances = [
        problem.space.distance(problem.space.point_of(t.parameters)[np.newaxis])[0] for t in (free, near)
    ]
    assert distances[1] < 0.6 * distances[0]
    own = [
        problem.costs_without_prior(problem.space.point_of(t.parameters)[np.newaxis], None)[0]
        for t in (free, near)
    ]
    assert own[1] < own[0] + 0.05


@pytest.mark.parametrize(("model", "scale"), [("planar8", "log10"), ("tilted12", "linear")])
def test_other_models_and_a_linear_search_of_noises_have_no_typical_values(model: str, scale: str):
    space = search_space(model, scale, 0.01, kind="ekf")
    points = np.random.default_rng(0).uniform(space.low, space.high, (3, len(space.names)))
    assert np.all(space.distance(points) == 0.0)


@pytest.mark.parametrize(
    ("asked", "prior", "inflation"),
    [
        ({"objective": "innovation-nll"}, 1.0, 0.05),
        ({"objective": "innovation-t + 0.1 nis"}, 1.0, 0.05),
        ({"objective": "innovation-t", "scale": "linear"}, 1.0, 0.0),
        ({"objective": "innovation-t", "prior": 0.0, "inflation": 0.0}, 0.0, 0.0),
        ({"objective": "innovation-t", "prior": 0.3, "inflation": 0.2}, 0.3, 0.2),
        ({"objective": "truth-pose"}, 0.0, 0.0),
        ({"objective": "truth-pose", "model": "tilted12"}, 0.0, 0.01),
        ({"objective": "truth-pose", "model": "tilted12", "inflation": 0.0}, 0.0, 0.0),
        ({"objective": "truth-pose", "model": "tilted12", "use": ("fix-error",)}, 0.0, 0.01),
        ({"objective": FIX_ERROR_OBJECTIVE, "model": "tilted12", "use": ("fix-error",)}, 0.3, 0.01),
        ({"objective": FIX_ERROR_OBJECTIVE, "model": "tilted12"}, 0.0, 0.01),
        ({"objective": FIX_ERROR_OBJECTIVE, "model": "planar8", "use": ("fix-error",)}, 0.0, 0.0),
        ({"objective": "gps-rmse", "model": "tilted12"}, 0.0, 0.0),
        ({"objective": "innovation-nll + 0.2 nees"}, 0.0, 0.0),
        ({"objective": "gps-rmse"}, 0.0, 0.0),
    ],
)
def test_the_prior_and_the_inflation_are_used_without_truth(asked, prior, inflation):
    config = with_default_guards(TuneConfig(**asked))
    assert (config.prior, config.inflation) == (prior, inflation)


def test_a_prior_in_nats_can_not_be_added_to_meters():
    with pytest.raises(InputError, match="prior = 1: the prior is in nats, but truth-rmse is not"):
        tune(town(), objective="truth-rmse", prior=1.0, **SEARCH)


def test_the_cost_of_a_validation_contains_no_prior():
    far = replace(
        simulate("urban", duration=60.0, gps="white-1m", seed=4, imu_rate=50.0), metadata={"gps_std_m": 20.0}
    )
    tuning = tune(town(), objective="innovation-nll", validation=far, inflation=0.0, **SEARCH)
    assert tuning.validation is not None
    assert (
        tuning.validation.cost == run_batch([far], [tuning.parameters], objective="innovation-nll").costs[0]
    )
    assert abs(tuning.validation.gap) < 0.3


@pytest.mark.parametrize(("true_std", "prior"), [(1.5, 0.3), (0.3, 0.0), (8.0, 0.0)])
def test_with_truth_the_prior_on_r_needs_a_receiver_that_is_as_accurate_as_stated(
    true_std: float, prior: float
):
    config = TuneConfig(model="tilted12", use=("fix-error",))
    cars = [replace(log_properties(town()), receiver_std=(2.1, 2.1), true_std=true_std)]
    assert complete_config(config, cars).prior == prior
    assert complete_config(config.model_copy(update={"prior": 0.7}), cars).prior == 0.7
