"""The live filter with arbitrary input: its estimate is finite, or it reports a failure."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filter_cases import KINDS, OPTIONS, parameters
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.live import LiveFilter
from support import quickly

START = InitialState(np.array([0.0, 0.0, 10.0, 0.0, 0.0]), np.diag([1.0, 1.0, 1.0, 1.0, 0.01]), 100.0)
ODD = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e20, 1e150])
NUMBER = st.one_of(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), ODD)
STEP = st.one_of(
    st.just(0.01), st.just(0.01), st.floats(-1.0, 1.0), st.sampled_from([9.9, 10.1, 1e4, -1e4]), ODD
)
CALL = st.tuples(
    st.sampled_from(["imu", "imu", "fix", "late fixes"]), STEP, NUMBER, NUMBER, NUMBER, st.booleans()
)


Call = tuple[str, float, float, float, float, bool]


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(
        product(("planar5", "planar8"), KINDS, ("plain", "all")),
        lambda model, kind, option: (
            (model, option) == ("planar8", "all") or (kind, option) == ("ukf", "plain")
        ),
    ),
)
@settings(max_examples=max(15, settings.default.max_examples // 4), deadline=None)
@given(calls=st.lists(CALL, max_size=40))
def test_the_state_is_finite_or_marked_as_failed(model: str, kind: str, option: str, calls: list[Call]):
    live = LiveFilter(
        parameters(model, kind=kind, **OPTIONS[option]), START, nominal_interval=0.01, history=0.2
    )
    process(live, calls)


def process(live: LiveFilter, calls: list[Call]) -> None:
    """Call the filter with all inputs, and check its state after each."""
    t = last = START.time
    for name, step, a, b, c, goes_on in calls:
        if name == "imu":
            live.predict(t + step, (a, b, c))
        elif name == "fix":
            live.update(t + step, (a, b), (c, a) if goes_on else None)
        else:
            for k in range(200):
                live.update(t - 0.1 - 1e-6 * k, (a, b))
        if goes_on and abs(step) < 2.0:
            t += step
        state = live.state
        assert state.failed or (np.isfinite(state.mean).all() and np.isfinite(state.covariance).all())
        assert state.time >= last
        last = state.time
    # It still accepts samples, unless it failed, or accepted two consecutive samples with times in the future.
    now = live.state.time
    live.predict(now + 0.01, (0.0, 0.0, 0.0))
    assert live.state.time == now + 0.01


@pytest.mark.parametrize("option", quickly([("plain",), ("all",)], lambda option: option == "all"))
@settings(max_examples=15, deadline=None)
@given(calls=st.lists(CALL, max_size=40))
def test_a_bank_accepts_the_same_inputs_as_a_filter(option: str, calls: list[Call]):
    p = parameters("planar8", **OPTIONS[option])
    alone, swarm = (
        kind(p, START, nominal_interval=0.01, history=0.2) for kind in (LiveFilter, LiveFilterBank)
    )
    for filter in (alone, swarm):
        process(filter, calls)
    counts = [(of.too_late, of.time_jumps, of.frozen) for of in (alone, swarm)]
    assert counts[0] == counts[1]
    assert (
        swarm._filter_state[: live.N_FILTER_STATE].tobytes()
        == alone._filter_state[: live.N_FILTER_STATE].tobytes()
    )


@pytest.mark.parametrize("kind", quickly([(k,) for k in KINDS], lambda kind: kind == "adaptive-ukf"))
def test_a_flood_of_late_fixes_is_bounded_and_counted(kind: str):
    live = LiveFilter(parameters("planar5", kind=kind), START, nominal_interval=0.01, history=0.2)
    for k in range(1, 301):
        live.predict(START.time + 0.01 * k, (0.0, 0.0, 0.0))
    now = live.state.time
    taken = sum(live.update(now - 0.1 + 1e-6 * k, (0.0, 0.0)) for k in range(3000))
    assert 0 < taken < 3000
    assert live.too_late == 3000 - taken
    assert not live.state.failed
    live.predict(now + 0.01, (0.0, 0.0, 0.0))
    assert live.state.time == now + 0.01
