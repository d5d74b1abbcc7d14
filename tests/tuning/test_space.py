"""The search space: every point is a filter within the paper's bounds, and bounds are exact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.errors import InputError
from sigmaswarm.tuning.bounds import TouchedBound
from sigmaswarm.tuning.space import TYPICAL_SLIP, search_space

LOWEST = [1e-3, 0.0, 0.0] + [1e-5] * 7
HIGHEST = [1.0, 3.0, 5.0] + [10.0] * 7
NAMES = ("alpha", "beta", "kappa", "q_x", "q_y", "q_vx", "q_vy", "q_theta", "r_x", "r_y")
SCALES = pytest.mark.parametrize("scale", ["log10", "linear"])


def values(parameters) -> list[float]:
    p = parameters
    return [p.alpha, p.beta, p.kappa, *p.process_noise, *p.measurement_noise]


@SCALES
def test_the_bounds_are_those_of_the_paper(scale):
    space = search_space("planar5", scale)
    assert space.names == NAMES
    assert space.lowest.tolist() == LOWEST
    assert space.highest.tolist() == HIGHEST


@SCALES
def test_the_bounds_are_exact(scale):
    space = search_space("planar5", scale)
    low, high = space.decode(np.array([space.low, space.high]))
    assert values(low) == LOWEST
    assert values(high) == HIGHEST


@SCALES
@given(shares=st.lists(st.floats(0, 1), min_size=10, max_size=10))
def test_every_point_within_the_bounds_is_a_filter_within_the_bounds(scale, shares: list[float]):
    space = search_space("planar5", scale)
    point = np.clip(space.low + np.array(shares) * (space.high - space.low), space.low, space.high)
    decoded = values(space.decode(point[None])[0])
    assert all(lo <= v <= hi for lo, v, hi in zip(LOWEST, decoded, HIGHEST, strict=True))
    for i, (share, v) in enumerate(zip(shares, decoded, strict=True)):
        if scale == "log10" and i >= 3:
            expected = 1e-5 * (10 / 1e-5) ** share
        else:
            expected = LOWEST[i] + share * (HIGHEST[i] - LOWEST[i])
        assert v == pytest.approx(expected, rel=1e-9)


def test_uniform_points_are_log_uniform_variances():
    rng = np.random.default_rng(0)
    log, linear = search_space("planar5", "log10"), search_space("planar5", "linear")
    small = [
        np.mean([p.process_noise[0] < 1e-2 for p in s.decode(rng.uniform(s.low, s.high, (2000, 10)))])
        for s in (log, linear)
    ]
    assert small[0] == pytest.approx(0.5, abs=0.05)  # half of the decades
    assert small[1] < 0.01
    alphas = [p.alpha for p in log.decode(rng.uniform(log.low, log.high, (2000, 10)))]
    assert np.mean(alphas) == pytest.approx(0.5, abs=0.03)  # not logarithmic


@SCALES
def test_touched_bounds_are_named(scale):
    space = search_space("planar5", scale)
    middle = (space.low + space.high) / 2
    assert space.touched(middle) == []
    point = middle.copy()
    point[[0, 5]] = space.low[[0, 5]]
    point[8] = space.high[8]
    touched = space.touched(point)
    assert touched == [
        TouchedBound("alpha", "lower", 1e-3),
        TouchedBound("q_vx", "lower", 1e-5),
        TouchedBound("r_x", "upper", 10.0),
    ]
    said = [
        "alpha at its lower bound (0.001)",
        "q_vx at its lower bound (1e-05)",
        "r_x at its upper bound (10)",
    ]
    assert list(map(str, touched)) == said
    assert list(map(TouchedBound.read, said)) == touched
    with pytest.raises(ValueError, match="is not a parameter at a bound"):
        TouchedBound.read("alpha at its lower end")
    almost = middle.copy()
    almost[8] = space.high[8] - 1e-3 * (space.high[8] - space.low[8])
    assert space.touched(almost) == []


@pytest.mark.parametrize(
    ("model", "use"), [("planar8", ()), ("planar8", ("lateral",)), ("planar5", ("lateral",))]
)
@given(seed=st.integers(0, 2**32 - 1))
def test_noise_variances_are_equal_in_east_and_north(model, use, seed: int):
    space = search_space(model, "log10", use=use)
    (p,) = space.decode(np.random.default_rng(seed).uniform(space.low, space.high)[None])
    x, y, vx, vy, theta, *biases = p.process_noise
    east, north = p.measurement_noise
    assert (x, vx, east) == (y, vy, north)
    assert len(biases) == {"planar5": 0, "planar8": 3}[model]
    noises = (x, vx, theta, *biases, east)
    assert len(set(noises)) == len(noises)  # all others differ
    assert {"q_xy", "q_vxy", "r_xy"} <= set(space.names)
    assert not {"q_x", "q_vy", "r_y"} & set(space.names)


@pytest.mark.parametrize("scale", ["log10", "linear"])
def test_the_bounds_include_large_errors_of_urban_fixes(scale: str):
    def bounds(model: str, *use: str) -> dict[str, tuple[float, float]]:
        space = search_space(model, scale, use=use)
        return dict(
            zip(space.names, zip(space.lowest.tolist(), space.highest.tolist(), strict=True), strict=True)
        )

    assert bounds("planar5", "lateral")["r_xy"] == (1e-5, 10.0)  # as in the paper
    assert bounds("planar8")["r_xy"] == (1e-5, 1e3)
    for model, name in (("planar5", "r_y"), ("planar8", "r_xy")):
        found = bounds(model, "accuracy", "robust")
        assert found[name] == (1e-4, 1e3)
        assert found["accuracy_scale"] == (1e-3, 10.0)
        assert found["robust_dof"] == (1.0, 30.0)


def test_the_scale_of_the_stated_accuracy_belongs_to_the_noises():
    space = search_space("planar8", "log10", use=("accuracy", "robust"))
    noises = np.array(space.names)[space.noises]
    assert {"accuracy_scale", "r_xy"} <= set(noises)
    assert "robust_dof" not in noises


@pytest.mark.parametrize(
    ("kind", "use", "said"),
    [
        ("ukf", ("gate", "robust"), "robust and gate can't be combined"),
        ("adaptive-ukf", ("robust",), "robust can't be combined with adaptive-ukf"),
        ("strong-tracking-ukf", ("robust",), "robust can't be combined with strong-tracking-ukf"),
        ("fuzzy-ukf", ("robust",), "robust can't be combined with fuzzy-ukf"),
        ("adaptive-ukf", ("accuracy",), "accuracy can't be combined with adaptive-ukf"),
    ],
)
def test_incompatible_options_are_rejected(kind, use, said: str):
    with pytest.raises(InputError, match=said) as refusal:
        search_space("planar8", "log10", kind=kind, use=use)
    assert "\n" not in str(refusal.value) and "omit" in str(refusal.value)


def test_the_parameters_have_the_nominal_interval():
    space = search_space("planar5", "log10", 0.02)
    assert space.decode(space.low[None])[0].nominal_interval == 0.02
    assert search_space("planar5", "log10").decode(space.low[None])[0].nominal_interval is None


def test_tire_slip_is_searched_if_it_is_selected():
    assert "tire_slip" not in search_space("planar8", "log10", use=("lateral",)).names
    space = search_space("planar8", "log10", use=("lateral", "slip"), has_truth=True)
    at = space.names.index("tire_slip")
    assert (space.lowest[at], space.highest[at], bool(space.logarithmic[at])) == (0.0, 0.02, False)
    blind = search_space("planar8", "log10", use=("lateral", "slip"))
    assert "tire_slip" not in blind.names
    assert blind.decode(blind.low[None])[0].tire_slip == TYPICAL_SLIP
    with pytest.raises(
        InputError,
        match=r"the option slip \(tire slip of the rear axle\) needs the option lateral; add lateral",
    ):
        search_space("planar8", "log10", use=("slip",))


def test_an_unknown_scale_is_refused():
    with pytest.raises(InputError, match="scale must be log10 or linear, not 'cubic'"):
        search_space("planar5", "cubic")


def test_the_bounds_of_tilted12_are_per_second_for_any_imu_rate():
    bounds = {
        interval: {d.name: d for d in search_space("tilted12", "log10", interval, kind="ekf").dimensions}
        for interval in (0.01, 0.02)
    }
    per_second = {
        "q_vxy": (1e-5, 1e2), "q_theta": (1e-10, 1e-1), "q_accel_bias": (1e-10, 1e-1), "q_gyro_bias_z": (1e-14, 1e-4),
        "q_tilt": (1e-10, 1e-2), "q_gyro_bias_xy": (1e-14, 1e-4),
    }  # fmt: skip
    names = ["q_xy", *per_second, "r_xy", "accel_bias_std", "gyro_bias_std"]
    assert list(bounds[0.01]) == names
    for interval, dimensions in bounds.items():
        for name, (low, high) in per_second.items():
            assert dimensions[name].lowest == pytest.approx(low * interval)
            assert dimensions[name].highest == pytest.approx(high * interval)
        assert (dimensions["q_xy"].lowest, dimensions["q_xy"].highest) == (1e-12, 10.0)
    assert sum(d.entries for d in bounds[0.01].values() if d.field == "process_noise") == 12
