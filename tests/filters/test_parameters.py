"""Parameters: exact after saving and loading, and rejected with the place of an error."""

import tomllib
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import SEARCHED, FilterParameters
from sigmaswarm.filters.run import run_filter, run_textbook
from sigmaswarm.tuning.tune import tune
from support import make_drive

GOOD = FilterParameters(0.1, 2.0, 0.5, (1.0, 2.0, 3.0, 4.0, 5.0), (6.0, 7.0))
TOML = """
[filter]
model = "planar5"
alpha = 0.1
beta = 2.0
kappa = 0.5
process_noise = [1, 2, 3, 4, 5]
measurement_noise = [6.0, 7.0]
"""

variances = st.floats(1e-300, 1e300)
parameters = st.builds(
    FilterParameters,
    st.floats(1e-12, 1e6),
    st.floats(-1e6, 1e6),
    st.floats(-4.99, 1e9),
    st.tuples(*[variances] * 5),
    st.tuples(*[variances] * 2),
    nominal_interval=st.one_of(st.none(), st.floats(1e-6, 10)),
)


@given(parameters)
def test_saved_parameters_load_to_the_same_bits(tmp_path_factory, p: FilterParameters):
    path = tmp_path_factory.getbasetemp() / "parameters.toml"
    p.save(path)
    assert FilterParameters.load(path) == p
    assert FilterParameters.load(str(path)) == p


def test_the_file_states_units_and_every_key(tmp_path: Path):
    replace(GOOD, nominal_interval=0.01).save(tmp_path / "p.toml")
    table = tomllib.loads((tmp_path / "p.toml").read_text())
    assert table["filter"] == {
        "model": "planar5",
        "alpha": 0.1,
        "beta": 2.0,
        "kappa": 0.5,
        "process_noise": [1, 2, 3, 4, 5],
        "measurement_noise": [6, 7],
        "nominal_interval": 0.01,
    }
    assert [unit.split()[0] for unit in table["units"]["process_noise"]] == [
        "m2",
        "m2",
        "m2/s2",
        "m2/s2",
        "rad2",
    ]
    assert table["units"]["measurement_noise"] == ["m2", "m2"]


def test_options_that_exclude_each_other_are_named_with_their_file(tmp_path: Path):
    (tmp_path / "p.toml").write_text(TOML + "gate = 9.2\nrobust_dof = 4\n")
    with pytest.raises(InputError) as refusal:
        FilterParameters.load(tmp_path / "p.toml")
    assert str(refusal.value).startswith(f"{tmp_path / 'p.toml'}: filter: ")
    assert "robust and gate can't be combined" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_filter_with_an_accuracy_scale_rejects_a_drive_without_accuracy():
    drive, p = make_drive(duration=20.0), replace(GOOD, accuracy_scale=1.0)
    for run in (run_filter, run_textbook):
        with pytest.raises(
            InputError,
            match=r"synthetic: the filter weights .* does not contain std_x and std_y for all fixes; use",
        ):
            run(drive, p)
    n = len(drive.gps)
    stated = replace(drive, gps=replace(drive.gps, std_x=np.ones(n), std_y=np.r_[np.nan, np.ones(n - 1)]))
    assert run_filter(stated, p).failure is None  # the first fix is before the start
    gap = replace(drive, gps=replace(drive.gps, std_x=np.ones(n), std_y=np.r_[np.ones(n - 1), np.nan]))
    with pytest.raises(InputError, match="for all fixes"):
        run_filter(gap, p)
    assert run_filter(gap, GOOD).mean.tobytes() == run_filter(drive, GOOD).mean.tobytes()


def test_the_stated_accuracy_determines_r():
    drive = make_drive(duration=20.0)
    n = len(drive.gps)
    stated = replace(drive, gps=replace(drive.gps, std_x=np.full(n, 2.0), std_y=np.full(n, 3.0)))
    by_hand = replace(GOOD, measurement_noise=(6.0 + 0.5 * 4.0, 7.0 + 0.5 * 9.0))
    assert (
        run_filter(stated, replace(GOOD, accuracy_scale=0.5)).mean.tobytes()
        == run_filter(drive, by_hand).mean.tobytes()
    )


def test_a_robust_filter_rejects_outliers_and_follows_a_jump():
    drive = make_drive(duration=40.0, gps_std=0.5)
    p = replace(GOOD, process_noise=(1e-4, 1e-4, 1e-3, 1e-3, 1e-6), measurement_noise=(0.25, 0.25))
    time = drive.gps.time
    assert drive.truth is not None

    def error(x: np.ndarray, p: FilterParameters) -> np.ndarray:
        estimate = run_filter(replace(drive, gps=replace(drive.gps, x=x)), p)
        assert estimate.failure is None
        truth = np.interp(estimate.time, drive.truth.time, drive.truth.x)
        return np.abs(estimate.mean[:, 0] - truth)[estimate.time > 15.0]

    robust = replace(p, robust_dof=4.0)
    burst = drive.gps.x + 20.0 * ((time > 20.0) & (time < 21.0))
    assert error(burst, robust).max() < 2.0 < 5.0 < error(burst, p).max()
    # a lasting jump is rejected for 5 s, then followed
    jumped = drive.gps.x + 200.0 * (time > 20.0)
    estimate = run_filter(replace(drive, gps=replace(drive.gps, x=jumped)), robust)
    off = estimate.mean[:, 0] - run_filter(drive, robust).mean[:, 0]
    assert np.all(np.abs(off[estimate.time < 24.9]) < 5.0)
    assert np.interp(25.3, estimate.time, off) == pytest.approx(200.0, abs=15.0)


def test_a_hand_written_file_loads(tmp_path: Path):
    (tmp_path / "p.toml").write_text(TOML)
    assert FilterParameters.load(tmp_path / "p.toml") == GOOD


def test_positional_arguments_and_numpy_arrays():
    q, r = np.array([1.0, 2, 3, 4, 5]), np.array([6.0, 7])
    p = FilterParameters(0.1, 2.0, 0.5, q, r)
    assert p == GOOD
    assert p.process_noise == (1.0, 2.0, 3.0, 4.0, 5.0)
    q[0] = 99.0
    assert p == GOOD  # a copy
    assert FilterParameters(np.float64(0.1), 2, 0.5, [1, 2, 3, 4, 5], [6, 7], model="planar5") == GOOD
    assert hash(p) == hash(GOOD)


def test_a_record_can_not_be_changed():
    with pytest.raises(FrozenInstanceError):
        GOOD.alpha = 0.2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"alpha": 0.0}, "alpha"),
        ({"alpha": -0.1}, "alpha"),
        ({"alpha": float("nan")}, "alpha"),
        ({"beta": float("inf")}, "beta"),
        ({"kappa": -5.0}, "kappa must be greater than -5"),
        ({"process_noise": (1.0,) * 4}, "process_noise needs 5 variances for planar5, got 4"),
        ({"process_noise": (1.0,) * 4 + (float("nan"),)}, "process_noise"),
        ({"measurement_noise": (1.0,) * 3}, "measurement_noise needs 2 variances, got 3"),
        ({"model": "planar8"}, "process_noise needs 8 variances for planar8, got 5"),
        ({"model": "planar9"}, "planar5"),
        ({"kind": "magic"}, "ukf"),
        ({"forgetting": 1.0}, "forgetting"),
        ({"gate": 0.0}, "gate"),
        ({"bias_std": (0.1,)}, "bias_std"),
        ({"nominal_interval": 0.0}, "nominal_interval"),
        ({"accuracy_scale": 0.0}, "accuracy_scale"),
        ({"robust_dof": -1.0}, "robust_dof"),
        ({"robust_dof": 4.0, "gate": 9.2}, "robust and gate can't be combined"),
        (
            {"robust_dof": 4.0, "kind": "strong-tracking-ukf"},
            "robust can't be combined with strong-tracking-ukf",
        ),
        ({"accuracy_scale": 1.0, "kind": "adaptive-ukf"}, "accuracy can't be combined with adaptive-ukf"),
    ],
    ids=str,
)
def test_invalid_values_are_rejected(change: dict, word: str):
    with pytest.raises(ValidationError, match=word):  # a ValueError
        replace(GOOD, **change)


def test_a_negative_variance_is_accepted_here_and_fails_in_the_filter():
    assert replace(GOOD, process_noise=(-1.0,) * 5).process_noise == (-1.0,) * 5


def without(key: str) -> str:
    return "\n".join(line for line in TOML.splitlines() if not line.startswith(key))


def with_value(key: str, value: str) -> str:
    return without(key) + f"\n{key} = {value}\n"


BAD_FILES: dict[str, tuple[str, list[str]]] = {
    "not-toml": ("alpha : 0.1", ["not readable", "line 1"]),
    "empty": ("", ["[filter]", "sigmaswarm tune"]),
    "no-filter-table": ("[result]\ncost = 1", ["[filter]"]),
    "filter-no-table": ("filter = 3", ["[filter]"]),
    "key-missing": (without("alpha"), ["filter.alpha", "correct"]),
    "unknown-key": (with_value("gamma", "3"), ["filter.gamma", "unknown key", "delete it"]),
    "not-a-number": (with_value("alpha", '"wide"'), ["filter.alpha", "'wide'", "correct"]),
    "alpha-0": (with_value("alpha", "0"), ["filter.alpha", "greater than 0", "is 0"]),
    "alpha-nan": (with_value("alpha", "nan"), ["filter.alpha", "is nan"]),
    "kappa": (with_value("kappa", "-7"), ["kappa must be greater than -5", "-7"]),
    "q-short": (with_value("process_noise", "[1, 2]"), ["process_noise needs 5 variances", "got 2"]),
    "q-no-list": (with_value("process_noise", "1.0"), ["filter.process_noise", "1.0"]),
    "q-negative": (
        with_value("process_noise", "[1, 2, 3, -4, 5]"),
        ["filter.process_noise[3]", "negative", "-4"],
    ),
    "q-infinite": (with_value("process_noise", "[1, 2, 3, inf, 5]"), ["filter.process_noise.3", "is inf"]),
    "r-negative": (with_value("measurement_noise", "[-1, 2]"), ["filter.measurement_noise[0]", "-1"]),
    "r-zero": (with_value("measurement_noise", "[1, 0]"), ["filter.measurement_noise[1]", "positive", "0"]),
    "model": (with_value("model", '"planar7"'), ["filter.model", "'planar7'", "planar5"]),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_rejected_with_one_line(tmp_path: Path, case: str):
    content, expected = BAD_FILES[case]
    path = tmp_path / "p.toml"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        FilterParameters.load(path)
    message = str(caught.value)
    print(message)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert [part for part in expected if part not in message] == [], message


def test_a_missing_file_and_a_folder_without_one(tmp_path: Path):
    with pytest.raises(InputError, match=r"nowhere.toml: no such file; specify a tuning.toml or the folder"):
        FilterParameters.load(tmp_path / "nowhere.toml")
    with pytest.raises(InputError, match=r"tuning.toml: no such file"):
        FilterParameters.load(tmp_path)


def test_a_file_that_is_not_text(tmp_path: Path):
    (tmp_path / "p.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not readable"):
        FilterParameters.load(tmp_path / "p.toml")


def test_a_tuning_loads_as_file_and_as_folder(tmp_path: Path):
    tuning = tune(make_drive(duration=12.0), out=tmp_path / "out", particles=3, generations=2)
    assert FilterParameters.load(tmp_path / "out" / "tuning.toml") == tuning.parameters
    assert FilterParameters.load(tmp_path / "out") == tuning.parameters
    assert tuning.parameters.nominal_interval == pytest.approx(0.01)


def test_q_is_converted_to_the_drive_s_interval():
    """A filter tuned at 100 Hz adds twice the variance per step with an IMU of 50 Hz."""
    drive = make_drive(duration=15.0)
    slow = replace(drive, imu=drive.imu.select(slice(None, None, 2)))
    q, r = (1e-3, 2e-3, 3e-3, 4e-3, 1e-6), (1.0, 1.0)
    stated = FilterParameters(0.5, 2.0, 0.0, q, r, nominal_interval=0.01)
    doubled = FilterParameters(0.5, 2.0, 0.0, tuple(2 * v for v in q), r)
    a, b = run_filter(slow, stated), run_filter(slow, doubled)
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-12)
    textbook = run_textbook(slow, stated)
    np.testing.assert_allclose(textbook.covariance, a.covariance, rtol=1e-7, atol=1e-10)
    assert np.max(np.abs(run_filter(slow, replace(stated, nominal_interval=None)).mean - a.mean)) > 1e-3
    at_home = run_filter(drive, stated).mean, run_filter(drive, replace(stated, nominal_interval=None)).mean
    np.testing.assert_allclose(*at_home, atol=1e-9)


def test_a_logarithmic_search_has_positive_bounds():
    assert all(0 < search.lowest < search.highest for search in SEARCHED.values() if search.logarithmic)
    assert not SEARCHED["latency"].logarithmic
