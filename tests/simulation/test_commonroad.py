"""The two-track model compared with the single-track drift model of commonroad-vehicle-models for the same inputs."""

import numpy as np
import pytest

from oracles import single_track_drift
from sigmaswarm.simulation.dynamics import (
    AX,
    AY,
    GRAVITY,
    PEDAL,
    STEER,
    VX,
    VY,
    YAW_RATE,
    X,
    Y,
    run_open_loop,
    start_state,
)
from support import quickly

pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed")

STEP = 0.002


def compare(steer, wanted, speed):
    """Return this model's record at every other millisecond, and the other's states for the inputs of this record."""
    p = single_track_drift.parameters()
    car = single_track_drift.as_vehicle(p)
    ours = run_open_loop(
        car, p.tire.p_dy1, start_state(0.0, 0.0, 0.0, speed, car), steer, wanted / single_track_drift.STRONG
    )
    ours = ours[:: round(STEP / 0.001)]
    rate = np.append(np.diff(ours[:, STEER]) / STEP, 0.0)
    theirs = single_track_drift.drive(p, speed, rate, ours[:, PEDAL] * single_track_drift.STRONG, STEP)
    return ours, theirs


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(
    ("speed", "amplitude", "frequency", "push"),
    quickly(
        [(15.0, 0.035, 0.25, 0.0), (25.0, 0.012, 0.5, 0.0), (12.0, 0.05, 0.15, 1.5), (8.0, 0.10, 0.2, 1.0)],
        lambda speed, *_: speed == 8.0,
    ),
)
def test_same_inputs_give_the_same_motion_below_04_g(speed, amplitude, frequency, push):
    time = np.arange(0, 8, 0.001)
    steer = amplitude * np.sin(2 * np.pi * frequency * time)
    wanted = push * np.sin(2 * np.pi * 0.2 * time)
    ours, theirs = compare(steer, wanted, speed)
    assert np.hypot(ours[:, AX], ours[:, AY]).max() < 0.4 * GRAVITY

    off = rms(ours[:, YAW_RATE] - theirs[:, 5]) / rms(theirs[:, 5])
    way = np.hypot(ours[-1, X] - theirs[-1, 0], ours[-1, Y] - theirs[-1, 1])
    print(f"yaw rate {off:.2%} RMS, path {way:.2f} m apart at the end")
    assert off < 0.05
    assert rms(np.hypot(ours[:, VX], ours[:, VY]) - theirs[:, 3]) < 0.01 * speed
    assert way < 0.01 * speed * 8
