"""Simulate drives of a Tesla Model 3 with seeded sensors, without a CARLA server.

    maneuvers -> planning -> dynamics -> motion -> sensors, gps -> scenarios -> Drive

docs/simulator.md lists the modeled effects.
"""

from sigmaswarm.simulation.environments import ENVIRONMENTS, VEHICLES, Environment
from sigmaswarm.simulation.gps import GPS_GRADES, GpsGrade, with_outliers
from sigmaswarm.simulation.maneuvers import MANEUVERS
from sigmaswarm.simulation.motion import TERRAINS, Terrain
from sigmaswarm.simulation.scenarios import PAPER_MANEUVERS, simulate, simulate_many
from sigmaswarm.simulation.sensors import IMU_GRADES, ODOMETER_GRADES, ImuGrade, OdometerGrade, Triad

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
