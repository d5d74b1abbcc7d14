"""Hostile sequences for live filters: ``python -m fuzzing.live --sequences 2000 --seed 1``."""

import argparse
import time
import warnings
from collections import Counter

import numpy as np

from sigmaswarm import FilterParameters, LiveFilter, LiveFilterBank
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.errors import InputError
from sigmaswarm.filters.live import LiveState
from sigmaswarm.filters.models import MODELS

START = InitialState(np.array([0.0, 0.0, 10.0, 0.0, 0.0]), np.diag([1.0, 1.0, 1.0, 1.0, 0.01]), 100.0)
ODD = (*(sign * 10.0**k for k in (-320, -150, 16, 20, 77, 155, 200, 308) for sign in (1, -1)), np.nan, np.inf)
NEVER_NUMBERS = (None, "1", 10**400, b"", [1.0], {})
STEPS = (0.01, 0.01, 0.01, 0.01, 0.0, -0.01, 0.5, 9.9, 10.1, 1e4, -1e4, 1e308, np.nan)
LIVE = tuple(name for name, model in MODELS.items() if not model.measures_imu)
OPTIONS = (
    {},
    {"velocity_noise": 0.1, "lateral_noise": 0.05, "standstill_noise": 1e-3},
    {"odometer_noise": 0.01, "gate": 6.0},
    {"accuracy_scale": 0.4},
)


def hostile_parameters(rng: np.random.Generator) -> FilterParameters:
    """A filter of any kind and option, half of them with noise far outside the bounds of a tuning."""
    model = str(rng.choice(LIVE))
    n, kinds = len(MODELS[model].states), MODELS[model].filter_types
    exponents = rng.uniform(-13, 3, n + 2) if rng.random() < 0.5 else rng.uniform(-6, -2, n + 2)
    noise = (10.0**exponents).tolist()
    while True:
        options = OPTIONS[rng.integers(len(OPTIONS))]
        try:
            kind = str(rng.choice(list(kinds)))
            return FilterParameters(0.5, 2.0, 1.0, noise[:n], noise[n:], model, kind=kind, **options)
        except ValueError:  # options that do not go together
            continue


def require_sound(state: LiveState) -> None:
    """Fail if a state is wrong and does not say so."""
    if state.failed:
        return
    variance = state.covariance.diagonal()
    assert np.isfinite(state.mean).all() and np.isfinite(state.covariance).all(), "not finite"
    assert (variance >= 0).all(), f"negative variance {variance.min():g}"
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    least = np.linalg.eigvalsh(state.covariance / scale / scale[:, np.newaxis])[0]
    assert least > -1e-6, f"indefinite covariance, least eigenvalue of the correlations {least:g}"


def feed(rng: np.random.Generator, *, bank: bool = False, events: int = 800) -> int:
    """Feed one filter with a drive that is broken at random; return the number of events.

    Raises
    ------
    AssertionError
        A state is wrong and ``failed`` is false.
    """
    p = hostile_parameters(rng)
    axes, odd_share = len(MODELS[p.model].imu), rng.choice([0.0, 0.003, 0.03])
    live = (LiveFilterBank if bank else LiveFilter)(p, START, nominal_interval=0.01, history=0.2)
    t = START.time

    def number(usual: float) -> object:
        if rng.random() >= odd_share:
            return usual
        return NEVER_NUMBERS[rng.integers(6)] if rng.random() < 0.1 else ODD[rng.integers(len(ODD))]

    def event(k: int) -> None:
        nonlocal t
        step = STEPS[rng.integers(len(STEPS))] if rng.random() < odd_share else 0.01
        turn = rng.normal(0, 0.3)
        sample = [number(v) for v in (rng.normal(), 10 * turn, turn, 9.8, 0.0, 0.0)[:axes]]
        live.predict(number(t + step), sample)
        if abs(step) < 1:
            t += step
        if k % 10 == 0:
            late = 0.1 if rng.random() < 0.2 else 0.0
            fix = [number(10 * (t - 100) + rng.normal()), number(rng.normal())]
            velocity = [number(10.0), number(0.0)] if rng.random() < 0.5 else None
            live.update(number(t - late), fix, velocity, [number(1.0), number(2.0)])
        if k % 5 == 0:
            live.update_odometer(number(t), number(10.0))

    for k in range(events):
        try:
            event(k)
        except InputError:
            t += 0.01
        require_sound(live.state)
    return events


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzzing.live", description=__doc__)
    parser.add_argument("--sequences", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first sequence")
    options = parser.parse_args()
    warnings.simplefilter("error")
    findings, events, began = Counter[str](), 0, time.monotonic()
    for k in range(options.first, options.first + options.sequences):
        try:
            events += feed(np.random.default_rng([options.seed, k]), bank=k % 10 == 9)
        except Exception as error:
            kind = f"{type(error).__name__}: {' '.join(str(error).split())[:80]}"
            if not findings[kind]:
                print(f"seed [{options.seed}, {k}]: {kind}", flush=True)
            findings[kind] += 1
        if k % 100 == 99:
            print(f"{k + 1} done, {events} events, {time.monotonic() - began:.0f} s", flush=True)
    took = time.monotonic() - began
    print(f"{options.sequences} sequences, {events} events, {took:.0f} s: {findings.total()} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    raise SystemExit(main())
