"""The process noise is inflated as far as the allowed increase of the cost permits."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from sigmaswarm import Drive, run_batch, simulate, tune
from sigmaswarm.drives.gyro_bias import GyroBiasEvidence
from sigmaswarm.drives.sensors import true_gyro_bias
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.inflation import REFERENCE_DURATION, STEP, inflate, predicted_bias, shown_bias
from sigmaswarm.tuning.problem import car_problem
from sigmaswarm.tuning.result import INFLATION_REMARK
from sigmaswarm.tuning.space import search_space
from support import quickly

pytestmark = pytest.mark.usefixtures("undiagnosed")


@cache
def town() -> Drive:
    return simulate("urban", duration=60.0, gps="white-1m")


SEARCH = {"optimizer": "de", "particles": 8, "generations": 6, "objective": "truth-rmse"}


POWERS = {
    "planar5": np.ones(5),
    "planar8": np.array([1, 1, 1, 1, 1, 1, 1, 0]),  # the gyro's bias does not depend on roads
    "tilted12": np.array(
        [0.5, 0.5, 0.5, 0.5, 0, 1, 1, 1, 0, 0, 1, 1]
    ),  # theta, roll and pitch are left alone
}
"""Powers of the factor, by state."""
EVERY_MODEL = pytest.mark.parametrize(
    "model", quickly([(m,) for m in POWERS], lambda model: model != "tilted12")
)


def raised(p: FilterParameters, factor: float) -> FilterParameters:
    q = np.array(p.process_noise) * factor ** POWERS[p.model]
    return replace(p, process_noise=tuple(q.tolist()))


def costs(*sets: FilterParameters) -> np.ndarray:
    return run_batch([town()], sets, objective=SEARCH["objective"]).costs


@EVERY_MODEL
@pytest.mark.parametrize("inflation", quickly([(0.2,), (1.0,)], lambda inflation: inflation == 1.0))
def test_the_cost_increases_by_at_most_the_inflation(inflation: float, model: str):
    plain, inflated_ = (tune([town()], inflation=m, model=model, **SEARCH) for m in (0.0, inflation))
    assert plain.inflation_factor == 1.0
    assert inflated_.inflation_factor > 1.0
    assert plain.parameters.measurement_noise == inflated_.parameters.measurement_noise
    share = inflation  # at 60 s, the whole increase is allowed
    low, now = costs(plain.parameters, inflated_.parameters)
    assert now == inflated_.cost
    assert now <= (1 + share) * low
    ratios = np.array(inflated_.parameters.process_noise) / np.array(plain.parameters.process_noise)
    np.testing.assert_array_equal(ratios[POWERS[model] == 0], 1.0)
    expected = inflated_.inflation_factor ** POWERS[model]
    inside = np.array([d.split(":")[0] for d in map(str, inflated_.touched_bounds)])
    if not len(inside):
        np.testing.assert_allclose(ratios, expected, rtol=1e-9)
        assert costs(raised(inflated_.parameters, 10**STEP))[0] > (1 + share) * low
    assert np.all(ratios <= expected * (1 + 1e-9))


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("planar5", "all process noise variances by {:.3g}"),
        ("planar8", "all process noise variances except that of the gyro's bias by {:.3g}"),
        (
            "tilted12",
            "the variances of the biases' random walks by {:.3g} and the process noise variances of position and "
            "velocity by {:.3g}",
        ),
    ],
)
def test_the_factor_is_saved_with_the_tuning(tmp_path, model: str, said: str):
    options = {**SEARCH, "inflation": 0.1, "model": model, "out": tmp_path / "t"}
    tuning = tune([town()], **options)
    assert tuning.to_dict()["result"]["inflation_factor"] == tuning.inflation_factor
    said = said.format(tuning.inflation_factor, tuning.inflation_factor**0.5)
    assert INFLATION_REMARK.format(said) in tuning.remarks
    again = tune([town()], resume=True, **options)
    assert again.parameters == tuning.parameters
    assert not [remark for remark in tuning.remarks if "--polish" in remark]


@pytest.mark.parametrize("one", quickly([(False,), (True,)], lambda one: not one), ids=["two drives", "one"])
def test_a_training_duration_above_the_reference_allows_a_smaller_increase(one: bool):
    lengths = [200.0] if one else [100.0, 100.0]
    drives = [simulate("urban", duration=s, gps="white-1m", seed=i) for i, s in enumerate(lengths)]
    plain, inflated_ = (tune(drives, inflation=m, model="planar8", **SEARCH) for m in (0.0, 0.5))
    share = 0.5 * REFERENCE_DURATION / sum(drive.duration for drive in drives)
    assert 1 < inflated_.cost / plain.cost <= 1 + share
    if not inflated_.touched_bounds:
        more = raised(inflated_.parameters, 10**STEP)
        assert run_batch(drives, [more], objective=SEARCH["objective"]).costs[0] > (1 + share) * plain.cost


@pytest.mark.parametrize(("model", "decades"), [("planar8", 0.3), ("tilted12", 0.4)])
def test_a_model_with_roll_and_pitch_has_a_longer_reference_duration(model: str, decades: float):
    space = search_space(model, "log10", 0.01, kind="ekf", use=("lateral",))
    problem = SimpleNamespace(
        space=space,
        data=[{"duration_s": 300.0}],
        config=TuneConfig(model=model, objective="innovation-t"),
        costs=lambda points, executor=None: 5.0 * np.max(points - space.low, axis=1),  # with a prior
        costs_without_prior=lambda points, executor=None: np.max(points - space.low, axis=1),
        relative_increase=lambda costs, cost: costs - cost,
        starts=lambda: (),
        true_gyro_biases=lambda: (),
    )
    assert inflate(problem, space.low, 0.96, None)[2] == pytest.approx(10**decades)


def test_a_linear_search_rejects_an_inflation():
    with pytest.raises(
        InputError, match="inflation needs scale = log10, since it multiplies process noise variances"
    ):
        tune([town()], inflation=0.1, scale="linear", **SEARCH)


LEAST = {"q_tilt": 2e-9, "q_gyro_bias_xy": 1e-12, "accel_bias_std": 0.005, "gyro_bias_std": 2e-4}
"""At 100 Hz: 0.01 of the variance per second."""


@pytest.mark.parametrize(
    ("objective", "drives", "biases"),
    [("innovation-t", 1, True), ("innovation-t", 3, True), ("truth-pose", 2, True), ("truth-pose", 3, False)],
)
@pytest.mark.parametrize("cost_per_decade", [0.0, 100.0])
@pytest.mark.parametrize("model", POWERS)
def test_a_tilted_model_has_lower_limits(
    model: str, cost_per_decade: float, objective: str, drives: int, biases: bool
):
    """A noise below its limit is set to the limit, whether or not the cost permits a factor."""
    space = search_space(model, "log10", 0.01, kind="ekf", use=("lateral",))

    class Lowest:
        """A problem whose optimum is at the lower bounds."""

        data: ClassVar = [{"duration_s": 100.0 / drives}] * drives
        config = TuneConfig(model="tilted12", objective=objective)

        def __init__(self):
            self.space = space

        def costs(self, points, executor=None):
            return cost_per_decade * np.sum(points - space.low, axis=1)

        costs_without_prior = costs

        def relative_increase(self, costs, cost):
            return costs - cost

        def starts(self):
            return ()

        def true_gyro_biases(self):
            return ()

    point, cost, factor = inflate(Lowest(), space.low, 0.02, None)
    assert cost == Lowest().costs(point[np.newaxis])[0]
    assert (factor == 1.0) == (cost_per_decade > 0)
    found = dict(zip(space.names, space.values(point), strict=True))
    lowest = dict(zip(space.names, space.lowest, strict=True))
    for name, least in LEAST.items() if model == "tilted12" else ():
        if not biases and name.endswith("bias_std"):
            assert found[name] == lowest[name]
            continue
        raised = found[name] > least * (1 + 1e-9)
        assert found[name] >= least * (1 - 1e-9)
        assert not raised or (factor > 1.0 and name.startswith("q_"))
    kept = [name for name in found if model != "tilted12" or name not in LEAST]
    if factor == 1.0:
        assert [found[name] for name in kept] == [lowest[name] for name in kept]


def seen(*bias: float) -> SimpleNamespace:
    return SimpleNamespace(gyro=GyroBiasEvidence(np.array(bias), np.full(3, 0.03**2), 0.0, np.zeros(5)))


def inflated_gyro_bias_std(starts: Sequence, true_biases: Sequence[float]) -> float:
    """Return the standard deviation of the gyro's initial bias after inflation, if the cost does not depend on it."""
    space = search_space("tilted12", "log10", 0.01, kind="ekf", use=("lateral",))
    problem = SimpleNamespace(
        space=space,
        data=[{"duration_s": 100.0}] * 3,
        config=TuneConfig(model="tilted12", objective="truth-pose"),
        costs=lambda points, executor=None: np.zeros(len(points)),
        costs_without_prior=lambda points, executor=None: np.zeros(len(points)),
        relative_increase=lambda costs, cost: costs - cost,
        starts=lambda: starts,
        true_gyro_biases=lambda: true_biases,
    )
    (found,) = space.decode(inflate(problem, space.low, 0.02, None)[0][np.newaxis])
    return found.bias_std[1]


@pytest.mark.parametrize(
    ("starts", "shown"),
    [
        ([seen(0.12, -0.06, 0.12), seen(0.03, 0.0, -0.03)], 0.0693),  # as for an MPU-6050
        ([seen(0.3, -0.3, 0.3)], 0.298),
        ([seen(0.03, -0.05, 0.06)], 0.0),  # as for a good gyro
        ([SimpleNamespace(gyro=None)], 0.0),
        ([], 0.0),
    ],
)
def test_biases_at_the_starts_give_a_lower_limit_of_the_gyro_bias_deviation(starts: list, shown: float):
    assert shown_bias(starts) == pytest.approx(shown, rel=1e-2)
    assert inflated_gyro_bias_std(starts, ()) == pytest.approx(min(max(shown, 1e-5), 0.1), rel=1e-2)


@pytest.mark.parametrize(
    ("biases", "predicted"),
    [
        ([], 0.0),
        ([np.nan, np.nan], 0.0),  # truth without a heading
        ([-3e-3], 3e-3),
        ([1e-3, -1e-3, np.nan], 1e-3),
        ([2e-3, -2e-3, 2e-3, -2e-3], 2e-3 * np.sqrt(2)),  # Student's t for a sample of four
    ],
)
def test_true_biases_predict_the_deviation_on_other_drives(biases: list[float], predicted: float):
    assert predicted_bias(biases) == pytest.approx(predicted)
    assert inflated_gyro_bias_std((), biases) == pytest.approx(max(predicted, 1e-5), rel=1e-6)


def test_truth_shows_the_gyro_bias_independently_of_its_scale():
    drive = simulate("urban", seed=1, duration=60.0, imu="ideal")
    for scale in (1.0, 1.02):  # the drive turns mostly to one side
        gz = scale * drive.imu.gz + 2e-3
        biased = replace(drive, imu=replace(drive.imu, gz=gz))
        assert true_gyro_bias(biased) == pytest.approx(2e-3, abs=5e-5)
    assert np.isnan(true_gyro_bias(replace(drive, truth=None)))
    problem = car_problem([biased] * 3, TuneConfig(model="tilted12", objective="truth-pose"))
    assert problem.true_gyro_biases() == pytest.approx([2e-3] * 3, abs=5e-5)
    problem = car_problem([biased] * 3, TuneConfig(model="tilted12", objective="innovation-t"))
    assert not len(problem.true_gyro_biases())  # only objectives with truth use it


@pytest.mark.parametrize(
    "missing", [(0.0, 0.0), (15.0, 40.0)], ids=["whole truth", "gap with most of a turn"]
)
def test_a_gap_of_the_truth_with_a_turn_shows_no_gyro_bias(missing: tuple[float, float]):
    drive = simulate("urban", seed=1, duration=60.0, imu="ideal")
    assert drive.truth is not None
    rate = 0.2 + 0.1 * np.sin(0.5 * (drive.imu.time - drive.imu.time[0]))
    turned = np.append(0.0, np.cumsum(np.diff(drive.imu.time) * (rate[1:] + rate[:-1]) / 2))
    theta = np.interp(drive.truth.time, drive.imu.time, turned)
    since = drive.truth.time - drive.imu.time[0]
    known = (since <= missing[0]) | (since >= missing[1])
    truth = replace(drive.truth, theta=np.where(known, np.angle(np.exp(1j * theta)), np.nan))
    turning = replace(drive, imu=replace(drive.imu, gz=rate + 2e-3), truth=truth)
    assert true_gyro_bias(turning) == pytest.approx(2e-3, abs=1e-4)
