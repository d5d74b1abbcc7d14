"""Wrong models and logs: each is rejected with one line that names the place, the fault and the remedy."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from custom_models import PARAMETERS, PENDULUM, pendulum_log
from sigmaswarm import InputError, Log, Tunable, run_model
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.custom.model import fingerprint

LOG = pendulum_log(duration=2.0)
N, F = len(LOG.time), len(LOG.measurement_time)


def error_message(call) -> str:
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    print(message)
    assert "\n" not in message
    return message


def with_value(column, at, value):
    changed = np.array(column)
    changed[at] = value
    return changed


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"time": LOG.time[:-1]}, "truth['angle'] has shape (201,), but time has 200 values"),
        ({"time": LOG.time[:, None]}, "time has shape (201, 1); pass one time"),
        ({"time": []}, "time has shape (0,)"),
        ({"time": with_value(LOG.time, 5, 0.0)}, "time[5] = 0 s does not come after 0.04 s; sort the rows"),
        ({"time": LOG.time + 100, "truth": {}}, "measurements[:, 0] has no value within time = 100 to 102 s"),
        ({"measurement_time": LOG.measurement_time[1:]}, "measurements has shape (20, 1), but measurement_time has 19"),
        ({"measurement_time": with_value(LOG.measurement_time, 3, np.inf)}, "measurement_time[3] is inf"),
        ({"measurements": with_value(LOG.measurements, (7, 0), np.nan)}, "measurements[7] has no value, only nan"),
        ({"measurements": with_value(LOG.measurements, (7, 0), np.inf)}, "measurements[7, 0] is inf; correct"),
        ({"measurements": np.full((F, 2), [1.0, np.nan])}, "measurements[:, 1] has no value, only nan; omit"),
        ({"measurements": np.zeros((F, 1, 1))}, "measurements has shape (20, 1, 1)"),
        ({"measurements": ["a"] * F}, "measurements is not an array of numbers"),
        ({"inputs": np.zeros(N - 1)}, "inputs has shape (200,), but time has 201 values"),
        ({"inputs": np.full(N, np.nan)}, "inputs[0] is nan"),
        ({"mean": [0.0, np.nan]}, "mean[1] is nan"),
        ({"mean": 3.0}, "mean has shape ()"),
        ({"covariance": np.eye(3)}, "covariance has shape (3, 3); pass a matrix of shape (2, 2) for 2 states"),
        ({"covariance": -np.eye(2)}, "covariance is not symmetric and positive definite"),
        ({"covariance": [[1.0, 0.5], [0.0, 1.0]]}, "covariance is not symmetric"),
        ({"truth": {"angle": [1.0]}}, "truth['angle'] has shape (1,), but time has 201 values"),
        ({"truth": {"angle": [1.0]}, "truth_time": [1.0, 2.0]}, "has shape (1,), but truth_time has 2 values"),
        ({"truth": {"angle": np.full(N, np.nan)}}, "truth['angle'][0] is nan"),
    ],
    ids=str,
)  # fmt: skip
def test_a_wrong_log_is_rejected_with_its_fault(change: dict, expected: str):
    parts = vars(LOG) | {"inputs": None, "truth_time": None} | change
    message = error_message(lambda: Log(**parts))
    assert message.startswith("log swing: ")
    assert expected in message


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"states": ("angle", "angle")}, "'angle' occurs twice in states"),
        ({"states": ()}, "states is empty"),
        ({"states": "angle"}, "states = 'angle' should be a tuple"),
        ({"states": ("an angle", "rate")}, "'an angle' in states is not a valid name"),
        ({"angles": ("heading",)}, "angles names 'heading', which is not a state; the states are angle, rate"),
        ({"scored": ("height",)}, "scored names 'height', which is not a state"),
        ({"parameters": ()}, "parameters is empty"),
        ({"parameters": (Tunable("q", 1, 2), Tunable("q", 1, 2))}, "'q' occurs twice"),
        ({"parameters": (Tunable("lambda", 1, 2),)}, "'lambda' in parameters is not a valid name"),
        ({"parameters": (Tunable("_q", 1, 2),)}, "'_q' in parameters is not a valid name"),
        ({"parameters": (Tunable("alpha", 1, 2),)}, "'alpha' in parameters is a parameter of the sigma points"),
        ({"parameters": (Tunable("q", 2, 1),)}, "the bounds 2, 1 of q are not a range; pass two finite"),
        ({"parameters": (Tunable("q", 1, math.nan),)}, "the bounds 1, nan of q"),
        ({"parameters": (Tunable("q", 0, 1),)}, "the lower bound 0 of q has no logarithm; pass a positive bound"),
        ({"f": 3}, "f = 3 is not a function"),
        ({"kind": "kf"}, "kind = 'kf'; choose ukf or ekf"),
    ],
    ids=str,
)  # fmt: skip
def test_a_wrong_model_is_rejected_with_its_fault(change: dict, expected: str):
    message = error_message(lambda: replace(PENDULUM, **change))
    assert message.startswith("model pendulum: ")
    assert expected in message


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"f": lambda s, dt, u, p: s[:1]}, "f returns shape (1,) on swing; return (2,)"),
        ({"f": lambda s, dt, u, p: s * u[0]}, "f fails on swing (IndexError, index 0 is out of bounds"),
        ({"f": lambda s, dt, u, p: s * p.mass}, "f fails on swing (AttributeError, 'p' object has no attribute 'mass'"),
        ({"f": lambda s, dt: s}, "f fails on swing (TypeError"),
        ({"h": lambda s, p: s}, "h returns shape (2,) on swing; return (1,)"),
        ({"h": lambda s, p: s[0]}, "h returns shape () on swing; return (1,)"),
        ({"process_noise": lambda dt, p: np.ones(3)}, "process_noise returns shape (3,) on swing; return (2,)"),
        ({"measurement_noise": lambda p: p.r_angle}, "measurement_noise returns shape () on swing"),
        (
            {"measured_angles": (1,)},
            "measured_angles contains the index 1, but a measurement of swing has 1 elements (indices from 0)",
        ),
        ({"kind": "ekf", "h": lambda s, p: np.arctan2(s[:1], 1.0)}, "h of a complex state fails on swing (TypeError"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)  # fmt: skip
def test_the_error_names_a_function_that_does_not_fit_the_log(change: dict, expected: str):
    model = replace(PENDULUM, **change)
    needed = {t.name for t in model.parameters}
    parameters = PARAMETERS if model.kind == "ukf" else {k: v for k, v in PARAMETERS.items() if k in needed}
    assert expected in error_message(lambda: run_model(LOG, model, parameters))


def test_the_error_names_what_does_not_fit_a_log_of_another_model():
    three = Log(**(vars(LOG) | {"mean": np.zeros(3), "covariance": np.eye(3)}))
    assert "mean has 3 values, but the model pendulum has 2 states" in error_message(
        lambda: run_model(three, PENDULUM, PARAMETERS)
    )
    tall = Log(**(vars(LOG) | {"truth": {"height": LOG.time}}))
    assert "truth names 'height', which is not a state" in error_message(
        lambda: run_model(tall, PENDULUM, PARAMETERS)
    )


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({k: v for k, v in PARAMETERS.items() if k != "length"}, "parameter 'length' is missing"),
        ({k: v for k, v in PARAMETERS.items() if k != "kappa"}, "parameter 'kappa' is missing"),
        (
            PARAMETERS | {"mass": 1.0},
            "there is no parameter 'mass'; the parameters are alpha, beta, kappa, length",
        ),
        (PARAMETERS | {"length": math.nan}, "parameter length = nan is not a finite number"),
        (PARAMETERS | {"length": "1"}, "parameter length = '1' is not a finite number"),
    ],
    ids=str,
)
def test_wrong_parameters_are_named(parameters: dict, expected: str):
    assert expected in error_message(lambda: run_model(LOG, PENDULUM, parameters))


# --- The identity of functions -----------------------------------------------------------------------------

OUTSIDE = 2.0


def takes_from_outside(x):
    return OUTSIDE * x


def nested(factor):
    def inner(x):
        return takes_from_outside(x) * factor

    return inner


def test_the_same_code_with_the_same_numbers_has_the_same_identity(monkeypatch: pytest.MonkeyPatch):
    same = fingerprint(nested(3.0))
    assert fingerprint(nested(3.0)) == same
    assert fingerprint(nested(4.0)) != same
    assert fingerprint(partial(nested, 3.0)) != fingerprint(partial(nested, 4.0))
    monkeypatch.setitem(globals(), "OUTSIDE", 2.5)  # read by a function that the function calls
    assert fingerprint(nested(3.0)) != same
    assert fingerprint(lambda x: x + 1) != fingerprint(lambda x: x + 2)
    assert fingerprint(lambda x: np.sin(x)) != fingerprint(lambda x: np.cos(x))


def test_a_model_s_identity_contains_all_its_parts(monkeypatch: pytest.MonkeyPatch):
    same = PENDULUM.identity()
    assert replace(PENDULUM).identity() == same
    assert same["parameters"][0] == {
        "name": "length",
        "lowest": 0.2,
        "highest": 3.0,
        "logarithmic": False,
        "unit": "m",
    }
    changes = [
        {"f": lambda s, dt, u, p: s},
        {"h": lambda s, p: s[1:]},
        {"process_noise": lambda dt, p: np.array([1e-11, p.q_rate]) * dt},
        {"measurement_noise": lambda p: np.array([2 * p.r_angle])},
        {"parameters": (replace(PENDULUM.parameters[0], highest=2.0), *PENDULUM.parameters[1:])},
        {"angles": ()},
        {"measured_angles": ()},
        {"scored": ("angle",)},
        {"kind": "ekf"},
        {"name": "swing"},
    ]
    hashes = {replace(PENDULUM, **change).identity()["sha256"] for change in changes}
    assert len(hashes | {same["sha256"]}) == len(changes) + 1


def test_the_old_name_of_indices_is_deprecated():
    with pytest.warns(SigmaswarmWarning, match="Model.places is deprecated, use Model.indices"):
        assert PENDULUM.places(PENDULUM.states) == PENDULUM.indices(PENDULUM.states)
