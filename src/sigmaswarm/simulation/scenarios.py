"""One simulated drive: a journey, its sensors and the truth.

Seed, maneuver, environment and run identify a drive. With its own name each sensor derives a stream of random numbers
from them, so a drive depends on nothing else, and a change of one sensor leaves the draws of the others unchanged.
"""

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.errors import InputError
from sigmaswarm.simulation.dynamics import STEP, Vehicle
from sigmaswarm.simulation.environments import Environment, find_environment
from sigmaswarm.simulation.gps import GpsGrade, degrade, find_gps, measure_gps
from sigmaswarm.simulation.imu import ImuGrade, find_imu, measure_imu
from sigmaswarm.simulation.journey import achieved_figures, take_journey
from sigmaswarm.simulation.motion import LeverArm, Motion, motion_at, sample, vibrate
from sigmaswarm.simulation.odometer import OdometerGrade, find_odometer, measure_odometer
from sigmaswarm.simulation.terrain import (
    HEIGHT,
    ROAD_PITCH,
    ROAD_ROLL,
    TERRAINS,
    Terrain,
    drive_on,
    find_terrain,
    lay_road,
)
from sigmaswarm.simulation.vehicle import find_vehicle

Array = NDArray[np.float64]

IMU_PLACE: LeverArm = (0.2, 0.0, 0.1)
"""m forward, left, up of the center of gravity: in the center console."""


def simulate(
    maneuver: str = "urban",
    environment: str | Environment = "clear",
    *,
    seed: int = 0,
    run: int = 0,
    imu: str | ImuGrade = "icm-20602",
    gps: str | GpsGrade = "ublox-m8",
    vehicle: str | Vehicle = "model3",
    imu_rate: float = 100.0,
    gps_rate: float = 5.0,
    jitter: float = 0.0,
    duration: float | None = None,
    warm_up: bool = True,
    imu_place: LeverArm = IMU_PLACE,
    vibration: float = 0.0,
    gnss_degradation: bool = False,
    terrain: str | Terrain = "flat",
    odometer: str | OdometerGrade | None = None,
) -> Drive:
    """Simulate one drive.

    Parameters
    ----------
    maneuver : str
        "cruise", "turns", "accelerate", "brake", "outages" or "urban".
    environment : str or Environment
        "clear", "night", "rain", "fog" or "slippery".
    seed, run : int
        Together with maneuver and environment they identify the drive; the same ones give the same drive.
    imu, gps : str or ImuGrade, GpsGrade
        See `IMU_GRADES` and `GPS_GRADES`.
    vehicle : str or Vehicle
        "model3" (the real car's pedals) or "model3-carla".
    imu_rate, gps_rate : float
        Hz, at most 1000.
    jitter : float
        s, standard deviation of each sample's time, clipped to 0.4 of the interval.
    duration : float, optional
        s, of "urban" only; 180 by default.
    warm_up : bool
        Begin with at least 30 m at 5 m/s or more, so that a filter can align. Without it a drive begins in motion
        with the maneuver itself.
    imu_place : tuple of float
        m forward, left, up of the center of gravity. The truth refers to this point.
    vibration : float
        Level of the vibration by road and engine; 1 is that of two recordings of real cars, in which the data
        sheet's noise is far too small. CARLA's IMU has none.
    gnss_degradation : bool
        Multiply the receiver's errors by the environment's factor: **an assumption, not a measurement**.
    terrain : str or Terrain
        "flat", "rolling" or "hilly": slopes of the road, which change the car's attitude and so the IMU's data. The
        path in the plane, and so the truth, is the same (within millimeters, as the IMU is above the center).
    odometer : str or OdometerGrade, optional
        "pulses", "can" or "ideal": see `ODOMETER_GRADES`. No odometer by default.

    Returns
    -------
    Drive
        With truth at the IMU's nominal times; its metadata hold the models, and target and achieved figures.

    Raises
    ------
    InputError
        For an unknown name or an impossible rate.
    """
    where = find_environment(environment)
    imu_grade, gps_grade = find_imu(imu), find_gps(gps)
    vehicle_name, car = find_vehicle(vehicle)
    ground = find_terrain(terrain)
    _check(imu_rate, gps_rate, jitter, vibration, duration, maneuver)
    if seed < 0 or run < 0:
        raise InputError(f"seed {seed} and run {run} must not be negative")
    if gnss_degradation:
        gps_grade = degrade(gps_grade, where.gnss_noise_factor)

    def stream(sensor: str) -> np.random.Generator:
        return _stream(seed, maneuver, where.name, run, sensor)

    journey = take_journey(maneuver, where, car, stream("driver"), duration, warm_up)
    record = journey.record
    if ground != TERRAINS["flat"]:
        record = drive_on(record, lay_road(journey.path[:, 3], ground, stream("road")), car)
    end = (len(record) - 1) * STEP
    nominal = _times(end, imu_rate, 0.0, stream("imu clock"))
    # CARLA ticks without jitter.
    ticks = nominal if imu_grade.carla else _times(end, imu_rate, jitter, stream("imu clock"))
    stamps = _times(end, gps_rate, jitter, stream("gps clock"))
    stamps = stamps[stamps >= gps_grade.latency]
    (i, j, k), (a, b, c) = imu_place, gps_grade.lever_arm
    antenna = (i + a, j + b, k + c)
    seen = motion_at(sample(record, stamps - gps_grade.latency), car, antenna)
    true = motion_at(sample(record, nominal), car, imu_place)
    felt = true if ticks is nominal else motion_at(sample(record, ticks), car, imu_place)
    if vibration > 0:
        felt = vibrate(felt, imu_rate, vibration, stream("vibration"))
    grade = None if odometer is None else find_odometer(odometer)
    wheels, scale = (None, 1.0) if grade is None else measure_odometer(record, car, grade, stream("odometer"))
    fixes = measure_gps(stamps, seen, gps_grade, stream("gps"), journey.outages)
    scenario = {
        "maneuver": maneuver,
        "environment": where.name,
        "physics": where.physics,
        "friction": where.friction,
        "seed": seed,
        "run": run,
        "warm_up": warm_up,
        "imu_rate_hz": imu_rate,
        "gps_rate_hz": gps_rate,
        "jitter_s": jitter,
        "vibration": vibration,
        "gnss_degradation": gnss_degradation,
        # A flat road adds no keys, as in files of early versions.
        **({} if ground == TERRAINS["flat"] else {"terrain": ground.name} | _slope_figures(record)),
        "outages": [list(window) for window in journey.outages],
    }
    return Drive(
        name=drive_name(maneuver, where.name, run),
        imu=measure_imu(ticks, felt, imu_grade, stream("imu")),
        gps=fixes,
        truth=_truth(nominal, true),
        metadata={
            "source": "sigmaswarm simulator",
            "vehicle": vehicle_name,
            **_noise_figures(imu_grade, gps_grade),
            **({} if grade is None else {"odometer": {"grade": grade.name, "scale": round(scale, 6)}}),
            "scenario": scenario,
            "imu_place": _place_figures(imu_place, car),
            "target": journey.maneuver.target,
            "achieved": achieved_figures(maneuver, journey, fixes.time),
        },
        odometer=wheels,
    )


def drive_name(maneuver: str, environment: str, run: int) -> str:
    """Return the name of a simulated drive, which is also that of its folder."""
    return f"{maneuver}-{environment}-{run:02d}"


def _slope_figures(record: Array) -> dict[str, float]:
    """Return figures of the road's slopes and climb."""
    grade, bank = (np.tan(record[:, i]) for i in (ROAD_PITCH, ROAD_ROLL))
    return {
        "grade_std_percent": round(100 * float(np.std(grade)), 2),
        "peak_grade_percent": round(100 * float(np.abs(grade).max()), 2),
        "peak_bank_percent": round(100 * float(np.abs(bank).max()), 2),
        "climb_m": round(float(np.ptp(record[:, HEIGHT])), 2),
    }


def _truth(times: Array, true: Motion) -> Truth:
    x, y, _ = true.position.T
    vx, vy, _ = true.velocity.T
    return Truth(time=times, x=x, y=y, vx=vx, vy=vy, theta=true.yaw)


def _stream(seed: int, maneuver: str, environment: str, run: int, sensor: str) -> np.random.Generator:
    names = (zlib.crc32(name.encode()) for name in (maneuver, environment, sensor))
    return np.random.default_rng(np.random.SeedSequence([seed, run, *names]))


def _times(end: float, rate: float, jitter: float, rng: np.random.Generator) -> Array:
    """Sample times from 0 to `end`, s, strictly increasing."""
    times = np.arange(int(end * rate + 1e-6) + 1) / rate
    late = np.clip(jitter * rng.standard_normal(len(times)), -0.4 / rate, 0.4 / rate)
    return np.clip(times + late, 0.0, end) if jitter > 0 else times


def _check(
    imu_rate: float, gps_rate: float, jitter: float, vibration: float, duration: float | None, maneuver: str
) -> None:
    for what, rate in (("imu_rate", imu_rate), ("gps_rate", gps_rate)):
        if not 0 < rate <= 1 / STEP:
            raise InputError(
                f"{what} is {rate:g} Hz; the simulator computes the car's motion at 1000 Hz: choose 0 to 1000"
            )
    for what, value in (("jitter", jitter), ("vibration", vibration)):
        if not 0 <= value < math.inf:
            raise InputError(f"{what} is {value:g}; choose 0 or more")
    check_duration(maneuver, duration)


def check_duration(maneuver: str, duration: float | None) -> None:
    """Raise `InputError` for a duration (s) that a maneuver can't have."""
    if duration is None:
        return
    if maneuver != "urban":
        raise InputError(
            f"duration is {duration:g} s for {maneuver!r}; only 'urban' has one, of 30 s or more"
        )
    if not 30 <= duration < math.inf:
        raise InputError(f"duration is {duration:g} s; an urban drive takes 30 s or more")


def _place_figures(place: LeverArm, car: Vehicle) -> dict[str, float]:
    forward, left, up = place
    return {
        "ahead_of_center_m": forward,
        "ahead_of_rear_axle_m": round(car.rear + forward, 6),
        "left_m": left,
        "above_center_m": up,
    }


def _noise_figures(imu: ImuGrade, gps: GpsGrade) -> dict[str, Any]:
    """Return the data sheets' figures under the keys that filters read, and the others in tables."""
    receiver: dict[str, Any] = {
        "grade": gps.name,
        "white_std_m": gps.white_std,
        "correlated_std_m": gps.markov_std,
        "correlation_time_s": gps.markov_time,
        "loss": gps.loss,
        "latency_s": gps.latency,
        "lever_arm_m": list(gps.lever_arm),
    }
    if gps.velocity_std is not None:
        receiver["velocity_std_ms"] = gps.velocity_std
    figures = {
        "accel_noise_density": imu.accel.noise_density,
        "gyro_noise_density": imu.gyro.noise_density,
        "gps_std_m": gps.std,
    }
    return {
        **{key: value for key, value in figures.items() if value > 0},  # ideal sensors state none
        **({"gps_lever_arm_m": list(gps.lever_arm)} if any(gps.lever_arm) else {}),
        "imu_noise": {
            "grade": imu.name,
            "accel_bias_std": imu.accel.bias_std,
            "gyro_bias_std": imu.gyro.bias_std,
            "bias_time_s": imu.bias_time,
            "accel_turn_on": imu.accel.turn_on,
            "gyro_turn_on": imu.gyro.turn_on,
            "accel_scale": imu.accel.scale,
            "gyro_scale": imu.gyro.scale,
            "accel_misalignment": imu.accel.misalignment,
            "gyro_misalignment": imu.gyro.misalignment,
        },
        "gps_noise": receiver,
    }
