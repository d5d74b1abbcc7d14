"""The single-track drift model of commonroad-vehicle-models, integrated, and its parameters as a `Vehicle`.

M. Althoff and G. Würsching, "CommonRoad: Vehicle Models", 2020: an independent implementation with the rotation of
wheels and a full magic formula, but with one track, and without relaxation of the tires, roll and pitch.
"""

import math

import numpy as np

from sigmaswarm.simulation.dynamics import Vehicle
from sigmaswarm.simulation.environments import MODEL_3

STRONG = 10.0  # m/s2, acceleration of a full pedal


def parameters():
    """Return the parameters of a BMW 320i, with coefficients of the tires."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return parameters_vehicle2()


def as_vehicle(p) -> Vehicle:
    """Convert the parameters to this project's model; those that they lack (relaxation, roll, lags) are kept."""
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
        wheel_inertia=p.I_y_w / 2,  # their value is that of an axle
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
        # Their force is mass times acceleration, without the inertia of the wheels.
        full_throttle=np.full(2, STRONG * p.m / inertia),
        coast=np.zeros(2),
        full_brake=np.full(2, -STRONG * p.m / inertia),
    )


def drive(p, speed: float, steer_rate: np.ndarray, acceleration: np.ndarray, step: float) -> np.ndarray:
    """Return states (n, 9) of their model for rates of the steering angle, rad/s, and accelerations, m/s2."""
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
