import numpy as np
import pytest

from sigmaswarm.simulation.dynamics import (
    AX,
    AY,
    FRICTION_USE,
    GRAVITY,
    PITCH,
    ROLL,
    VX,
    VY,
    YAW_RATE,
    X,
    run_open_loop,
    start_state,
)
from sigmaswarm.simulation.environments import MODEL_3, MODEL_3_CARLA, VEHICLES

NEUTRAL = MODEL_3._replace(coast=np.zeros_like(MODEL_3.coast))


def run(car, friction, speed, steer, pedal):
    """Return the recorded motion; steering and pedal are numbers or arrays, and at least one is an array."""
    steer, pedal = (np.ascontiguousarray(v, dtype=float) for v in np.broadcast_arrays(steer, pedal))
    return run_open_loop(car, friction, start_state(0.0, 0.0, 0.0, speed, car), steer, pedal)


@pytest.mark.parametrize("car", VEHICLES.values(), ids=VEHICLES)
@pytest.mark.parametrize("friction", [0.1, 0.25, 0.85])
@pytest.mark.parametrize("pedal", [0.0, -0.3, -1.0])
def test_a_standing_car_stays_where_it_is(car, friction, pedal):
    record = run(car, friction, 0.0, np.full(3000, car.steer_max), pedal)
    assert np.abs(record[:, [X, VX, VY, YAW_RATE, AX, AY]]).max() < 1e-9


@pytest.mark.parametrize("car", VEHICLES.values(), ids=VEHICLES)
@pytest.mark.parametrize("friction", [0.1, 0.25, 0.85])
@pytest.mark.parametrize("throttle", [0.1, 1.0])
def test_at_full_lock_the_motion_is_finite_within_the_friction_circle_and_ends_at_rest(
    car, friction, throttle
):
    pedal = np.concatenate([np.full(6000, throttle), np.full(14000, -1.0)])
    record = run(car, friction, 0.0, np.full(20000, car.steer_max), pedal)
    assert np.isfinite(record).all()
    assert record[:, FRICTION_USE].max() <= 1.0 + 1e-9
    assert np.abs(record[-1, [VX, VY, YAW_RATE]]).max() < 1e-3


@pytest.mark.parametrize("friction", [0.1, 0.25, 0.65, 0.85])
def test_full_brakes_use_exactly_the_available_friction(friction):
    record = run(MODEL_3, friction, 14.0, 0.0, np.full(20000, -1.0))
    moving = record[300 : np.argmax(record[:, VX] < 0.5)]
    drag = 0.5 * 1.204 * MODEL_3.drag_area * 14.0**2 / MODEL_3.mass
    assert -record[:, AX].min() <= friction * GRAVITY + drag
    assert -moving[:, AX].mean() > 0.92 * friction * GRAVITY
    assert abs(record[-1, VX]) < 1e-6


@pytest.mark.parametrize("car", [MODEL_3, MODEL_3_CARLA, NEUTRAL], ids=["model3", "model3-carla", "neutral"])
def test_coast_down_loses_speed_monotonically(car):
    record = run(car, 0.85, 30.0, 0.0, np.zeros(60000))
    assert (np.diff(record[:, VX]) <= 0).all()
    assert (record[:, VX] > -1e-6).all()


def test_in_neutral_the_energy_never_increases():
    steer = 0.15 * np.sin(2 * np.pi * 0.4 * np.arange(20000) / 1000)
    record = run(NEUTRAL, 0.85, 12.0, steer, 0.0)
    energy = (
        NEUTRAL.mass * (record[:, VX] ** 2 + record[:, VY] ** 2)
        + NEUTRAL.yaw_inertia * record[:, YAW_RATE] ** 2
    )
    assert (np.diff(energy[::50]) < 1e-4 * energy[0]).all()
    assert energy[-1] < 0.9 * energy[0]


def test_carlas_pedals_agree_with_measurements_in_carla():
    car = MODEL_3_CARLA
    # With high grip, the pedal maps determine the acceleration.
    throttle = run(car, 3.5, 0.0, 0.0, np.full(3000, 1.0))[500:, AX]
    assert throttle.min() > 6.2 and throttle.max() < 7.1
    assert run(car, 3.5, 20.0, 0.0, np.zeros(1000))[-1, AX] == pytest.approx(-1.58, abs=0.15)
    brake = run(car, 3.5, 18.0, 0.0, np.full(6000, -1.0))
    assert brake[np.argmax(brake[:, VX] < 14.0), AX] == pytest.approx(-7.4, abs=0.2)
    stop = np.argmax(brake[:, VX] < 0.05) - np.argmax(brake[:, VX] < 50 / 3.6)
    assert stop / 1000 == pytest.approx(2.66, abs=0.15)  # derived from the measured map, s


def test_steady_cornering_follows_the_understeer_gradient():
    """Steering angle = wheelbase x curvature + gradient x lateral acceleration, in the linear range."""
    steer, speed = 0.02, 15.0
    car = NEUTRAL._replace(drag_area=0.0, rolling_resistance=0.0, load_sensitivity=0.0)
    record = run(car, 0.85, speed, np.full(4000, steer), 0.0)[-1]
    gradient = (1 / car.cornering_front - 1 / car.cornering_rear) / GRAVITY
    expected = record[VX] * steer / (car.front + car.rear + gradient * record[VX] ** 2)
    assert record[YAW_RATE] == pytest.approx(expected, rel=0.02)


def test_the_body_rolls_outward_and_dives_as_specified():
    car = MODEL_3
    turn = run(car, 0.85, 15.0, np.full(4000, 0.03), 0.1)[-1]
    assert turn[ROLL] == pytest.approx(turn[AY], rel=0.02)  # stored as the acceleration that causes this roll
    stop = run(car, 0.85, 25.0, 0.0, np.full(2000, -0.4))[-1]
    assert stop[PITCH] == pytest.approx(stop[AX], rel=0.02)


def test_mirrored_steering_mirrors_the_motion():
    steer = 0.1 * np.sin(np.arange(5000) / 700)
    left, right = (run(MODEL_3, 0.65, 10.0, sign * steer, 0.2) for sign in (1, -1))
    np.testing.assert_allclose(left[:, VX], right[:, VX], rtol=1e-9)
    np.testing.assert_allclose(left[:, YAW_RATE], -right[:, YAW_RATE], atol=1e-9)
