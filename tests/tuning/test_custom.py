"""Tuning of a custom model: the result, the same bits, resumption, and rejected inputs."""

import json
import signal
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from custom_models import PARAMETERS, PENDULUM, SCALING, pendulum_log, point_log, point_model
from filters.custom.test_run import exact_nll
from processes import Process
from sigmaswarm import InputError, Log, Tunable, run_model, tune
from support import file_contents, make_drive, quickly, several, some
from tuning.test_resume import generations_in, interrupted
from tuning.test_tune import bits

POINT = point_model()
LOGS = [pendulum_log(name, seed=seed, duration=10.0) for seed, name in enumerate(("a", "b"))]
SMALL = {"model": PENDULUM, "particles": 5, "generations": 6, "trials": 2, "seed": 3}


@pytest.mark.long
def test_the_likelihood_estimates_the_noise_of_the_log():
    """Compare with the optimum of an exact likelihood, and with the truth within three standard deviations."""
    log = point_log(n=300, q=0.5, r=0.3)
    asked = {"particles": 10, "generations": 25, "polish": 100}
    tuning = tune(log, model=POINT, objective="innovation-nll", **asked)

    def exact(x: np.ndarray) -> float:
        return float(exact_nll(log, *(10.0**x)).sum())

    found = np.log10([tuning.parameters["q"], tuning.parameters["r"]])
    best = minimize(exact, found + 0.1, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6})
    n = len(log.measurement_time)
    assert tuning.cost == pytest.approx(best.fun / n, abs=1e-5)
    assert found == pytest.approx(best.x, abs=0.02)
    step = 1e-2 * np.eye(2)  # the curvature of the likelihood gives the standard deviation
    information = np.array(
        [[(exact(best.x + a + b) - exact(best.x + a - b) - exact(best.x - a + b) + exact(best.x - a - b)) / 4e-4
          for a in step] for b in step]
    )  # fmt: skip
    deviation = np.sqrt(np.diag(np.linalg.inv(information)))
    assert deviation.max() < 0.2  # otherwise, the test is not sensitive
    assert np.all(np.abs(found - np.log10([0.5, 0.3])) < 3 * deviation)


@pytest.mark.parametrize(
    "objective", quickly([("truth-rmse",), ("innovation-nll",)], lambda objective: objective != "truth-rmse")
)
def test_an_unknown_length_is_estimated(objective: str):
    options = {
        "particles": 20,
        "generations": 30,
        "trials": 1,
        "optimizer": "pso",
        "zero_velocity_at_bounds": True,
    }
    tuning = tune(LOGS[:1], model=PENDULUM, objective=objective, **options)
    assert tuning.parameters["length"] == pytest.approx(0.8, rel=0.02)
    if objective == "innovation-nll":
        assert tuning.parameters["r_angle"] == pytest.approx(4e-4, rel=0.4)
        assert 1e-4 < tuning.parameters["q_rate"] < 1e-2
    assert {t.parameter for t in tuning.touched_bounds} <= {"alpha", "beta", "kappa"}


def test_the_cost_is_that_of_the_parameters():
    def estimates(tuning):
        return [run_model(log, PENDULUM, tuning.parameters) for log in LOGS]

    tuning = tune(LOGS, objective="innovation-nll", **SMALL)
    assert tuning.cost == np.mean([e.nll.mean() for e in estimates(tuning)])
    assert (
        f"on 2 logs\nfilter: pendulum (ukf), 2 trials\nparameters: alpha {tuning.parameters['alpha']:.3g}, "
        in repr(tuning)
    )
    assert f"length {tuning.parameters['length']:.3g} m, q_rate " in repr(tuning)
    tuning = tune(LOGS, **SMALL)
    wrong = [e.mean - np.column_stack([log.truth["angle"], log.truth["rate"]])
             for e, log in zip(estimates(tuning), LOGS, strict=True)]  # fmt: skip
    assert tuning.cost == pytest.approx(
        np.mean([np.sqrt(np.mean(np.sum(w**2, axis=1))) for w in wrong]), rel=1e-12
    )
    scored = tune(LOGS, **(SMALL | {"model": replace(PENDULUM, scored=("rate",))}))
    wrong = [e.mean[:, 1] - log.truth["rate"] for e, log in zip(estimates(scored), LOGS, strict=True)]
    assert scored.cost == pytest.approx(np.mean([np.sqrt(np.mean(w**2)) for w in wrong]), rel=1e-12)


def test_estimates_at_times_of_truth_are_interpolated_across_pi():
    log = pendulum_log(start=(0.7, 9.0), duration=6.0)
    moments = np.arange(0.2043, 7.0, 0.31)
    truth = {"angle": (np.interp(moments, log.time, log.truth["angle"]) + np.pi) % (2 * np.pi) - np.pi}
    sparse = Log(**(vars(log) | {"truth": truth, "truth_time": moments}))
    tuning = tune(sparse, **SMALL)
    mean = run_model(log, PENDULUM, tuning.parameters).mean[:, 0]
    inside = moments <= 6.0
    wrong = np.interp(moments[inside], log.time, np.unwrap(mean)) - truth["angle"][inside]
    wrong -= 2 * np.pi * np.round(wrong / (2 * np.pi))
    assert tuning.cost == pytest.approx(np.sqrt(np.mean(wrong**2)), rel=1e-9)


def test_the_same_seed_gives_the_same_bits_for_any_number_of_workers():
    results = [tune(LOGS, **SMALL)]
    with ThreadPoolExecutor(3) as pool:
        results.append(tune(LOGS, executor=pool, **SMALL))
    assert all(bits(r) == bits(results[0]) for r in results)
    assert bits(tune(LOGS, **(SMALL | {"seed": 4}))) != bits(results[0])


def test_an_extended_filter_is_tuned_too():
    tuning = tune(
        point_log(n=100),
        model=point_model(kind="ekf"),
        objective="innovation-nll",
        particles=4,
        generations=3,
    )
    assert list(tuning.parameters) == ["q", "r"]
    assert tuning.cost == pytest.approx(
        exact_nll(point_log(n=100), tuning.parameters["q"], tuning.parameters["r"]).mean(), rel=1e-9
    )


def test_filters_that_fail_have_infinite_cost_and_are_counted():
    broken = replace(PENDULUM, measurement_noise=lambda p: np.array([-1.0 if p.length > 1.0 else p.r_angle]))
    tuning = tune(LOGS[0], objective="innovation-nll", **(SMALL | {"model": broken, "particles": 20}))
    assert 0 < tuning.trials[0].failures < tuning.trials[0].evaluations
    assert tuning.parameters["length"] <= 1.0


@pytest.mark.parametrize("variance", [-1.0, np.nan, -np.inf])
def test_variances_that_no_filter_can_use_are_named_with_the_model(variance: float):
    never = replace(PENDULUM, kind="ekf", measurement_noise=lambda p: np.array([variance]))
    reason = rf"no parameter set gave.*model {PENDULUM.name}, log a: .*check that all variances are positive"
    with pytest.raises(InputError, match=reason):
        tune(LOGS[0], **(SMALL | {"model": never}))


# --- Remedies ----------------------------------------------------------------------------------------------

FULL_RANGE = (1e-4, 1e2)


@pytest.mark.parametrize(
    ("q", "r", "touched"),
    several(
        [((1e-4, 1e-2), FULL_RANGE, "q"), ((20.0, 1e2), FULL_RANGE, "q"), (FULL_RANGE, (1e-4, 0.03), "r")], 3
    ),
)
def test_wider_bounds_remove_the_advice_to_widen_them(
    q: tuple[float, float], r: tuple[float, float], touched: str
):
    options: dict[str, Any] = {"objective": "innovation-nll", "trials": 1, "particles": 6, "polish": 50}
    costs: list[float] = []
    for bounds in ((q, r), (FULL_RANGE, FULL_RANGE)):
        tunables = tuple(Tunable(n, *b) for n, b in zip("qr", bounds, strict=True))
        tuning = tune(
            point_log(n=150), model=point_model(kind="ekf", parameters=tunables), generations=10, **options
        )
        said = [remark for remark in tuning.remarks if "widen the bounds in your model" in remark]
        assert any(f". Reason: {touched} at its" in remark for remark in said) == bool(said) == (not costs)
        costs.append(tuning.cost)
    assert costs[1] < costs[0]


@pytest.mark.parametrize("seed", some(range(3), 3))
def test_more_generations_remove_the_advice_to_increase_them(seed: int):
    options: dict[str, Any] = {"objective": "innovation-nll", "particles": 4, "trials": 1, "seed": seed}
    few, many = (
        tune(point_log(n=150), model=point_model(kind="ekf"), generations=g, **options) for g in (1, 20)
    )
    assert [any("increase --generations" in remark for remark in t.remarks) for t in (few, many)] == [
        True,
        False,
    ]
    assert many.cost < few.cost


# --- Saved files -------------------------------------------------------------------------------------------


def test_the_file_contains_the_parameters_by_name_and_the_model(tmp_path: Path):
    tuning = tune(LOGS, out=tmp_path, **SMALL)
    table = tomllib.loads((tmp_path / "tuning.toml").read_text())
    assert table["filter"] == tuning.parameters == tuning.to_dict()["filter"]
    assert list(table["filter"]) == ["alpha", "beta", "kappa", "length", "q_rate", "r_angle"]
    assert table["units"] == {
        "length": "m",
        "q_rate": "rad2/s3",
        "r_angle": "rad2",
        "states": ["angle", "rate"],
    }
    assert table["config"]["model"] == PENDULUM.identity()
    assert "scored states" in table["result"]["objective_meaning"]
    assert [d["name"] for d in table["data"]] == ["a", "b"]
    assert run_model(LOGS[0], PENDULUM, table["filter"]).failure is None
    again = tune(LOGS, **(table["config"] | {"model": PENDULUM}))
    assert bits(again) == bits(tuning)
    assert json.loads((tmp_path / "config.json").read_text())["model"] == PENDULUM.identity()


@pytest.mark.parametrize("generation", quickly([(1,), (7,)], lambda generation: generation == 7))
def test_a_resumed_tuning_ends_in_the_same_bytes(tmp_path: Path, generation: int):
    tune(LOGS, out=tmp_path / "whole", **SMALL)
    interrupted(LOGS, tmp_path / "cut", generation, **SMALL)
    tune(LOGS, out=tmp_path / "cut", resume=True, **SMALL)
    assert file_contents(tmp_path / "cut") == file_contents(tmp_path / "whole")


KILLED = {"particles": 6, "generations": 40, "trials": 1, "seed": 8}
PROGRAM = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from custom_models import PENDULUM, pendulum_log
from sigmaswarm import tune
tune(pendulum_log(), model=PENDULUM, out=sys.argv[1], **{KILLED})
"""


@pytest.mark.long
def test_a_tuning_killed_in_another_process_ends_here_in_the_same_bytes(tmp_path: Path):
    """The functions have the same identity in every process; otherwise the tuning could not be resumed."""
    checkpoint = tmp_path / "killed" / "checkpoint-000.npz"
    run = Process(PROGRAM, [tmp_path / "killed"])
    while generations_in(checkpoint) < 10:
        assert run.poll() is None, "the process ended before it was killed"
        time.sleep(0.002)
    run.kill()
    assert run.wait() == -signal.SIGKILL
    assert not (tmp_path / "killed" / "trial-000").exists()
    tune(pendulum_log(), model=PENDULUM, out=tmp_path / "killed", resume=True, **KILLED)
    tune(pendulum_log(), model=PENDULUM, out=tmp_path / "whole", **KILLED)
    assert file_contents(tmp_path / "killed") == file_contents(tmp_path / "whole")


# --- Errors ------------------------------------------------------------------------------------------------


def refusal(call) -> str:
    with pytest.raises(InputError) as caught:
        call()
    print(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_tuning_of_another_model_is_not_resumed(tmp_path: Path):
    interrupted(LOGS, tmp_path, 2, **SMALL)
    other = replace(PENDULUM, kind="ekf", h=lambda state, p: state[:1] + 0.0)  # it is not compiled
    message = refusal(lambda: tune(LOGS, out=tmp_path, resume=True, **(SMALL | {"model": other})))
    assert "the tuning was started with the model pendulum (" in message
    assert len(message) < 300
    nudged = Log(**(vars(LOGS[0]) | {"mean": LOGS[0].mean + 1e-9}))
    assert "a (" in refusal(lambda: tune([nudged, LOGS[1]], out=tmp_path, resume=True, **SMALL))


def test_invalid_tunings_are_rejected(tmp_path: Path):
    out = tmp_path / "out"
    blind = Log(**(vars(LOGS[0]) | {"truth": {}}))
    for call, expected in (
        (lambda: tune([], out=out, **SMALL), "there are no logs; pass at least one"),
        (lambda: tune(LOGS, out=out), "got a Log; tune takes Drives, or Logs together with model=Model(...)"),
        (lambda: tune(make_drive(duration=10.0), out=out, **SMALL), "got a Drive"),
        (
            lambda: tune(LOGS, out=out, objective="truth-pose", **SMALL),
            "'truth-pose' is not available for a custom model",
        ),
        (
            lambda: tune(blind, out=out, objective="truth-rmse", **SMALL),
            "log a: has no truth for truth-rmse; add the truth, or tune with innovation",
        ),
        (
            lambda: tune(LOGS, out=out, use=("gate",), **SMALL),
            "use = ('gate',) is only possible with built-in models; add the sensor to h",
        ),
        (
            lambda: tune(LOGS, out=out, outage_seed=1, **SMALL),
            "outage_seed = 1 is only possible with built-in models; omit",
        ),
        (
            lambda: tune(LOGS, out=out, start="t.toml", **SMALL),
            "start is only possible with built-in models; narrow the b",
        ),
        (
            lambda: tune(LOGS, out=out, paper=True, **SMALL),
            "paper = True is only possible with built-in models; omit paper",
        ),
        (
            lambda: tune(LOGS, out=out, n_trials=2, **SMALL),
            "n_trials = 2: no such option; did you mean trials?",
        ),
        (lambda: tune(LOGS, out=out, **(SMALL | {"particles": 1})), "particles = 1"),
    ):
        assert expected in refusal(call)
    speed = Log(**(vars(LOGS[0]) | {"truth": {"rate": LOGS[0].truth["rate"]}}))
    scored = SMALL | {"model": replace(PENDULUM, scored=("angle",))}
    assert "has no truth of 'angle'" in refusal(lambda: tune(speed, out=out, **scored))
    late = Log(**(vars(LOGS[0]) | {"truth": {"rate": [1.0]}, "truth_time": [99.0]}))
    assert "truth covers t = 99 to 99 s" in refusal(lambda: tune(late, out=out, **SMALL))
    assert not out.exists()
    with ProcessPoolExecutor(1) as pool:
        assert "use a ThreadPoolExecutor" in refusal(lambda: tune(LOGS, executor=pool, **SMALL))


def test_the_bounds_are_those_of_the_model():
    tuning = tune(LOGS[0], **(SMALL | {"scale": "linear"}))
    assert tuning.trials[0].point.tolist() == list(tuning.parameters.values())
    log10 = tune(LOGS[0], **SMALL)
    point, parameters = log10.trials[0].point, list(log10.parameters.values())
    assert point[:4].tolist() == parameters[:4]
    assert 10 ** point[4:] == pytest.approx(parameters[4:], rel=1e-12)
    assert set(SCALING | PARAMETERS) == set(log10.parameters)
