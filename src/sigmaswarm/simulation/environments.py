"""Environments and cars of a simulation.

Environments: friction of the road, and the assumed effect of weather on satellite navigation. Darkness and fog do not
change traction; in CARLA no weather changes traction (carla-simulator/carla#655). Clear, night and fog have the same
friction. Therefore, without ``gnss_degradation``, only three of the paper's five environments differ.

Cars: a Tesla Model 3, and CARLA's model of it. Sources, cited after the values: [C] CARLA 0.9's vehicle.tesla.model3 as
listed by public scoring scripts, and pedal maps measured in CARLA. [O] opendbc and other public lists. [R] from memory
or typical of the class, not verified. [D] derived from other values.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.simulation.dynamics import GRAVITY, Vehicle


@dataclass(frozen=True)
class Named:
    name: str


T = TypeVar("T")
N = TypeVar("N", bound=Named)


def by_name(*records: N) -> dict[str, N]:
    return {record.name: record for record in records}


@dataclass(frozen=True)
class Environment(Named):
    """Friction and weather of a drive.

    Attributes
    ----------
    name : str
    friction : float
        Peak friction between tire and road.
    gnss_noise_factor : float
        Factor by which the weather multiplies the receiver's errors if ``gnss_degradation`` is set: **an assumption,
        not a measurement**.
    source : str
        Source of the friction.
    """

    friction: float
    gnss_noise_factor: float
    source: str

    @property
    def physics(self) -> str:
        """Description of the friction: dry, wet, snow, or its value."""
        return {0.85: "dry", 0.65: "wet", 0.25: "snow"}.get(self.friction, f"friction {self.friction:g}")


_DRY = "Bosch Automotive Handbook: new tires, dry, 50 km/h"

# In the paper's order
ENVIRONMENTS = by_name(
    Environment("clear", 0.85, 1.0, _DRY),
    Environment("night", 0.85, 1.0, _DRY),
    Environment("rain", 0.65, 1.3, "Bosch Automotive Handbook: new tires, wet, 50 km/h"),
    Environment("fog", 0.85, 1.1, _DRY),
    Environment("slippery", 0.25, 1.2, "packed snow, 0.2-0.3: from memory, not verified"),
)


def lookup(value: str | T, table: dict[str, T], what: str) -> T:
    """Look up a name in a table, or return a record unchanged. Raises `InputError` for an unknown name."""
    if not isinstance(value, str):
        return value
    if value not in table:
        raise InputError(f"no {what} is called {value!r}; choose from {', '.join(table)}")
    return table[value]


# Real car, dual motor.
MODEL_3 = Vehicle(
    mass=1850.0,  # [O] 1844-1899 kg
    yaw_inertia=3400.0,  # [R]
    front=1.495,  # [D] wheelbase 2.875 m [O], 48% of the weight in front [R]
    rear=1.380,
    track=1.58,  # [O]
    height=0.46,  # [R]
    drag_area=0.23 * 2.22,  # [R]
    rolling_resistance=0.010,  # [R]
    wheel_radius=0.335,  # [R] 235/45 R18
    wheel_inertia=2.0,  # [R] wheel 1.2, motor 0.8 kg m2
    slip_stiffness=20.0,  # [R] commonroad-vehicle-models: 22.3 for a BMW 320i
    cornering_front=15.0,  # [R] less than the tire's, due to the compliance of the steering; 0.7 deg/g understeer
    cornering_rear=18.5,  # [R]
    load_sensitivity=0.2,  # [R]
    tire_shape=1.4,  # [R] commonroad-vehicle-models: 1.35 lateral, 1.64 longitudinal
    relaxation_longitudinal=0.15,  # [R] measurements: 0.04-0.3 m
    relaxation_lateral=0.40,  # [R]
    drive_front_share=0.45,  # [R] dual motor
    brake_front_share=0.60,  # [R] about the front axle's share of the load in a hard stop
    roll_front_share=0.55,  # [R]
    steer_max=0.61,  # [R] 35 deg
    steer_rate=0.70,  # [D] 480 deg/s at the steering wheel [R] over a ratio of 12 [O]
    steer_lag=0.05,  # [R]
    pedal_rate=7.0,  # [R] 0.14 s for a full stroke
    pedal_lag=0.06,  # [R]
    roll_gain=math.radians(4.0) / GRAVITY,  # [R] 4 deg/g
    roll_frequency=2 * math.pi * 1.5,  # [R]
    roll_damping=0.3,  # [R]
    pitch_gain=math.radians(3.0) / GRAVITY,  # [R] 3 deg/g
    pitch_frequency=2 * math.pi * 1.5,  # [R]
    pitch_damping=0.3,  # [R]
    # Pedals of the real car [R]: 0-100 km/h in about 4.5 s; recuperation if no pedal is pressed; the brakes can exceed
    # the grip of the tires.
    pedal_speed=np.array([0.0, 1.0, 5.0, 20.0, 30.0, 45.0]),
    full_throttle=np.array([6.3, 6.5, 6.5, 6.5, 4.5, 2.8]),
    coast=np.array([0.0, 0.0, -1.5, -1.5, -1.1, -0.7]),
    full_brake=np.array([-11.0, -11.0, -11.0, -11.0, -11.0, -11.0]),
)

# Mass, drag and pedals of CARLA, whose brakes stop the car from 50 km/h in 2.7 s.
MODEL_3_CARLA = MODEL_3._replace(
    mass=1845.0,  # [C]
    drag_area=0.15 * 3.2,  # [C] coefficient; area [D] of its bounding box 2.16 m x 1.49 m
    steer_max=math.radians(70.0),  # [C]
    # Pedals of CARLA, measured [C]. Assumptions between the measured speeds: coasting fades below 10 m/s, and the
    # braking below 4.5 m/s is constant, so that a stop from 50 km/h takes the measured 2.66 s.
    pedal_speed=np.array([0.0, 4.5, 10.0, 14.0, 30.0]),
    full_throttle=np.array([6.3, 6.6, 6.8, 7.0, 7.0]),
    coast=np.array([0.0, -0.71, -1.58, -1.58, -1.58]),
    full_brake=np.array([-4.4, -4.4, -6.1, -7.4, -7.4]),
)

VEHICLES = {"model3": MODEL_3, "model3-carla": MODEL_3_CARLA}


def find_vehicle(vehicle: str | Vehicle) -> tuple[str, Vehicle]:
    name = vehicle if isinstance(vehicle, str) else "custom"
    return name, lookup(vehicle, VEHICLES, "vehicle")
