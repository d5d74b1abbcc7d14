"""Simulate drives of a Tesla Model 3 with seeded sensors, without a CARLA server.

    maneuvers -> planning -> dynamics -> journey -> terrain -> motion -> imu, gps, odometer -> scenarios -> Drive

docs/simulator.md lists the modeled effects.
"""

from sigmaswarm.simulation.conditions import PAPER_MANEUVERS, simulate_many
from sigmaswarm.simulation.environments import ENVIRONMENTS, Environment
from sigmaswarm.simulation.gps import GPS_GRADES, GpsGrade, with_outliers
from sigmaswarm.simulation.imu import IMU_GRADES, ImuGrade, Triad
from sigmaswarm.simulation.maneuvers import MANEUVERS
from sigmaswarm.simulation.odometer import ODOMETER_GRADES, OdometerGrade
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.simulation.terrain import TERRAINS, Terrain
from sigmaswarm.simulation.vehicle import VEHICLES

__all__ = [
    "ENVIRONMENTS",
    "GPS_GRADES",
    "IMU_GRADES",
    "MANEUVERS",
    "ODOMETER_GRADES",
    "PAPER_MANEUVERS",
    "TERRAINS",
    "VEHICLES",
    "Environment",
    "GpsGrade",
    "ImuGrade",
    "OdometerGrade",
    "Terrain",
    "Triad",
    "simulate",
    "simulate_many",
    "with_outliers",
]
