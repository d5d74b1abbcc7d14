"""The single-track drift model of commonroad-vehicle-models, integrated, with its parameters as a `Vehicle`.

M. Althoff and G. Würsching, "CommonRoad: Vehicle Models", 2020: an independent implementation with wheels
that spin and a full magic formula, but one track, no relaxation of the tires, no roll and no pitch.
"""

import math

import numpy as np

from sigmaswarm.simulation.dynamics import Vehicle
from sigmaswarm.simulation.environments import MODEL_3

STRONG = 10.0  # m/s2, of a full pedal in our terms


def parameters():
    """Their BMW 320i, with the tire's coefficients."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return parameters_vehicle2()


def as_vehicle(p) -> Vehicle:
    """Their parameters in our model; what theirs lacks (relaxation, roll, lags) stays as ours is."""
    inertia = p.m + 2 * p.I_y_w / p.R_w**2
    return MODEL_3._replace(
        mass=p.m,
        yaw_inertia=p.I_z,
        front=p.a,
        rear=p.b,
        track=(p.T_f + p.T_r) / 2,
        height=p.h_s,
        drag_area=0.0,
        rolling_resistance=0.0,
        wheel_radius=p.R_w,
        wheel_inertia=p.I_y_w / 2,  # theirs is an axle's
        slip_stiffness=p.tire.p_kx1,
        cornering_front=-p.tire.p_ky1,
        cornering_rear=-p.tire.p_ky1,
        load_sensitivity=0.0,
        tire_shape=p.tire.p_cy1,
        drive_front_share=p.T_se,
        brake_front_share=p.T_sb,
        steer_max=p.steering.max,
        steer_rate=p.steering.v_max,
        pedal_lag=0.01,
        pedal_speed=np.array([0.0, 50.0]),
        # Theirs makes a force of mass times acceleration, wheels not included.
        full_throttle=np.full(2, STRONG * p.m / inertia),
        coast=np.zeros(2),
        full_brake=np.full(2, -STRONG * p.m / inertia),
    )


def drive(p, speed: float, steer_rate: np.ndarray, acceleration: np.ndarray, step: float) -> np.ndarray:
    """States (n, 9) of their model under rates of the steering angle, rad/s, and accelerations, m/s2."""
    from vehiclemodels.init_std import init_std
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    x = np.array(init_std([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0], p))
    states = np.empty((len(steer_rate), len(x)))

    def slope(state: np.ndarray, u: list[float]) -> np.ndarray:
        return np.array(vehicle_dynamics_std(list(state), u, p))

    for i, u in enumerate(zip(steer_rate.tolist(), acceleration.tolist(), strict=True)):
        states[i] = x
        command = list(u)
        k1 = slope(x, command)
        k2 = slope(x + step / 2 * k1, command)
        k3 = slope(x + step / 2 * k2, command)
        k4 = slope(x + step * k3, command)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert math.isfinite(x.sum())
    return states
